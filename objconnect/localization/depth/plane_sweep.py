"""Plane sweep of whole photographs, for many pixels at once."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.depth.grey_photograph import GreyPhotograph

# Side of cells, pixels: points are projected at their centres and interpolated between them.
_CELL: Final = 8
# Planes compared at once: few enough for the processor's cache.
_PLANES: Final = 4
# Pixel coordinate of points without a projection.
_NOWHERE: Final = -1e4
# Standard deviation (grey levels) below which a window has no texture.
_PLAIN: Final = 1.0


class PlaneSweep:
    """Correlates windows around pixels with other photographs warped over fronto-parallel planes.

    The sums of the normalised correlation are box filters over the whole picture.

    Args:
        photograph: the reference photograph.
        window: side of the window, pixels.
        border: pixels at the edge of other photographs that are not used.
    """

    def __init__(self, photograph: GreyPhotograph, window: int, border: float) -> None:
        self._grey = grey = photograph.grey.numpy()
        self._pose = photograph.pose
        self._window = (window, window)
        self._border = border
        self._mean = cv2.boxFilter(grey, -1, self._window)
        self._variance = cv2.boxFilter(grey * grey, -1, self._window) - self._mean**2
        height, width = grey.shape
        self._cells = (-(-height // _CELL) + 2, -(-width // _CELL) + 2)
        v, u = (_CELL * (np.arange(count) - 0.5) for count in self._cells)
        nodes = torch.from_numpy(np.stack(np.meshgrid(u, v), -1).reshape(-1, 2))
        self._rays, self._valid = photograph.camera.unproject(nodes)

    def __call__(
        self, xy: NDArray[np.float64], inverse_depths: Tensor, other: GreyPhotograph
    ) -> NDArray[np.float32]:
        """Return the correlation (N, D) of pixels (N, 2) at inverse depths (D,), 1/metres.

        It is -1 where the other photograph does not show the plane.
        """
        height, width = self._grey.shape
        column, row = np.clip(xy.astype(int), 0, [width - 1, height - 1]).T
        pixel = row * width + column
        mean, variance = (of.ravel()[pixel] for of in (self._mean, self._variance))
        low = self._border - 0.5
        high = np.array([other.camera.width, other.camera.height]) - self._border - 0.5
        found = np.empty((len(inverse_depths), len(xy)), np.float32)
        nodes = self._nodes(inverse_depths, other)
        for begin in range(0, len(nodes), _PLANES):
            warps = self._interpolate(nodes[begin : begin + _PLANES])
            x, y = np.moveaxis(warps.reshape(len(warps), -1, 2)[:, pixel], -1, 0)
            inside = (x >= low) & (x < high[0]) & (y >= low) & (y < high[1])
            theirs, squares, products = self._sums(warps, other.grey.numpy(), pixel)
            spread = squares - theirs**2
            plain = (variance < _PLAIN**2) | (spread < _PLAIN**2)
            value = (products - mean * theirs) / np.sqrt(np.where(plain, 1.0, variance * spread))
            value = np.where(plain, 0.0, value)
            found[begin : begin + _PLANES] = np.where(inside, value, -1.0)
        return found.T

    def _sums(
        self, warps: NDArray[np.float32], grey: NDArray[np.float32], pixel: NDArray[np.int64]
    ) -> NDArray[np.float32]:
        """Return window means (3, D, N) of a photograph under warps (D, H, W, 2), of its squares
        and of its products with the reference."""
        sums = np.empty((3, *warps.shape[:3]), np.float32)
        for warp, theirs, squares, products in zip(warps, *sums, strict=True):
            seen = cv2.remap(grey, warp, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            cv2.boxFilter(seen, -1, self._window, dst=theirs)
            cv2.sqrBoxFilter(seen, cv2.CV_32F, self._window, dst=squares)
            cv2.boxFilter(np.multiply(seen, self._grey, out=seen), -1, self._window, dst=products)
        return sums.reshape(3, len(warps), -1)[:, :, pixel]

    def _nodes(self, inverse_depths: Tensor, other: GreyPhotograph) -> NDArray[np.float32]:
        """Return the centres of cells on planes, projected into another photograph,
        (D, rows, columns, 2), in OpenCV's pixels."""
        relative = other.pose @ self._pose.inverse()
        points = self._rays / inverse_depths[:, None, None].double()
        projected = other.camera.project(relative.transform(points.flatten(0, 1)))
        usable = projected.valid & self._valid.repeat(len(inverse_depths))
        xy = torch.where(usable[:, None], projected.xy - 0.5, _NOWHERE)
        nodes: NDArray[np.float32] = xy.view(-1, *self._cells, 2).float().numpy()
        return nodes

    def _interpolate(self, nodes: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the projections of every pixel, (D, H, W, 2), from those of ``_nodes``."""
        height, width = self._grey.shape
        size = (self._cells[1] * _CELL, self._cells[0] * _CELL)
        warps = np.empty((len(nodes), height, width, 2), np.float32)
        for warp, node in zip(warps, nodes, strict=True):
            between = cv2.resize(node, size, interpolation=cv2.INTER_LINEAR)
            warp[:] = between[_CELL : _CELL + height, _CELL : _CELL + width]
        return warps
