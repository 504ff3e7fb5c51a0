"""Plane sweep of whole photographs, for many pixels at once."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.depth.grey_photograph import GreyPhotograph

# Side of the cells of a grid, pixels. The centres of cells are projected exactly; projections of
# other pixels are interpolated between them.
_CELL_PX: Final = 8
# Number of planes that are compared at once, few enough for the processor's cache.
_PLANES_AT_ONCE: Final = 4
# Pixel coordinate of points without a projection.
_NOWHERE: Final = -1e4
# Standard deviation (grey levels) below which a window has no texture.
_MIN_TEXTURE: Final = 1.0


class PlaneSweep:
    """Correlates windows around pixels with other photographs warped over fronto-parallel planes.

    The sums of the normalised correlation are box filters over the whole picture.

    Args:
        photograph: the reference photograph.
        window: side of the window, pixels.
        border: width of the edge of other photographs that is not used, pixels.
    """

    def __init__(self, photograph: GreyPhotograph, window: int, border: float) -> None:
        self._grey = grey = photograph.grey.numpy()
        self._pose = photograph.pose
        self._window = (window, window)
        self._border = border
        self._mean = cv2.boxFilter(grey, -1, self._window)
        self._variance = cv2.boxFilter(grey * grey, -1, self._window) - self._mean**2
        height, width = grey.shape
        self._cells = (-(-height // _CELL_PX) + 2, -(-width // _CELL_PX) + 2)
        v, u = (_CELL_PX * (np.arange(count) - 0.5) for count in self._cells)
        nodes = torch.from_numpy(np.stack(np.meshgrid(u, v), -1).reshape(-1, 2))
        self._rays, self._valid = photograph.camera.unproject(nodes)

    def __call__(
        self, xy: NDArray[np.float64], inverse_depths: Tensor, other: GreyPhotograph
    ) -> NDArray[np.float32]:
        """Return the correlation (N, D) of pixels (N, 2) at inverse depths (D,), 1/metres.

        It is -1 where the other photograph does not show the plane, and 0 where a window has no
        texture.
        """
        height, width = self._grey.shape
        column, row = np.clip(xy.astype(int), 0, [width - 1, height - 1]).T
        pixel = row * width + column
        mean, variance = (values.ravel()[pixel] for values in (self._mean, self._variance))
        low = self._border - 0.5
        high = np.array([other.camera.width, other.camera.height]) - self._border - 0.5
        found = np.empty((len(inverse_depths), len(xy)), np.float32)
        nodes = self._nodes(inverse_depths, other)
        for begin in range(0, len(nodes), _PLANES_AT_ONCE):
            warps = self._interpolate(nodes[begin : begin + _PLANES_AT_ONCE])
            x, y = np.moveaxis(warps.reshape(len(warps), -1, 2)[:, pixel], -1, 0)
            inside = (x >= low) & (x < high[0]) & (y >= low) & (y < high[1])
            other_mean, squares, products = self._window_means(warps, other.grey.numpy(), pixel)
            other_variance = squares - other_mean**2
            plain = (variance < _MIN_TEXTURE**2) | (other_variance < _MIN_TEXTURE**2)
            scale = np.sqrt(np.where(plain, 1.0, variance * other_variance))
            value = np.where(plain, 0.0, (products - mean * other_mean) / scale)
            found[begin : begin + _PLANES_AT_ONCE] = np.where(inside, value, -1.0)
        return found.T

    def _window_means(
        self, warps: NDArray[np.float32], grey: NDArray[np.float32], pixel: NDArray[np.int64]
    ) -> NDArray[np.float32]:
        """Return means over the windows of pixels, (3, D, N), of a warped photograph, of its square
        and of its product with the reference photograph.

        Args:
            warps: (D, H, W, 2) pixel of the photograph for each pixel of the reference photograph.
            grey: (h, w) the photograph.
            pixel: (N,) indices of the pixels in the flattened reference photograph.
        """
        means = np.empty((3, *warps.shape[:3]), np.float32)
        for warp, mean, squares, products in zip(warps, *means, strict=True):
            warped = cv2.remap(grey, warp, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            cv2.boxFilter(warped, -1, self._window, dst=mean)
            cv2.sqrBoxFilter(warped, cv2.CV_32F, self._window, dst=squares)
            np.multiply(warped, self._grey, out=warped)
            cv2.boxFilter(warped, -1, self._window, dst=products)
        return means.reshape(3, len(warps), -1)[:, :, pixel]

    def _nodes(self, inverse_depths: Tensor, other: GreyPhotograph) -> NDArray[np.float32]:
        """Return the projections of cell centres on D planes into another photograph,
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
        size = (self._cells[1] * _CELL_PX, self._cells[0] * _CELL_PX)
        warps = np.empty((len(nodes), height, width, 2), np.float32)
        for warp, node in zip(warps, nodes, strict=True):
            between = cv2.resize(node, size, interpolation=cv2.INTER_LINEAR)
            warp[:] = between[_CELL_PX : _CELL_PX + height, _CELL_PX : _CELL_PX + width]
        return warps
