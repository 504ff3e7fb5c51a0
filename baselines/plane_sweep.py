"""Correlation of whole photographs on planes of equal depth, for many pixels at once."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from baselines.grey_photograph import GreyPhotograph

# Cells, in pixels, at whose middles points are projected; between these the projection is linear.
_CELL: Final = 8
# Where a plane has no picture.
_NOWHERE: Final = -1e4
# Grey levels: windows of a smaller deviation are plain.
_PLAIN: Final = 1.0


class PlaneSweep:
    """Compares the surroundings of pixels with what other photographs show of planes there.

    The planes are parallel to the picture. A window on a plane is compared by normalised
    correlation, whose sums are box filters over the whole picture.

    Args:
        photograph: the picture.
        window: side of the window, pixels.
        border: pixels at the edge of other pictures that are not compared.
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

        It is -1 where the other picture does not show the plane.
        """
        grey = other.grey.numpy()
        column, row = np.clip(xy.astype(int), 0, np.array(self._grey.shape[::-1]) - 1).T
        mean, variance = self._mean[row, column], self._variance[row, column]
        places = self._places(inverse_depths, other)
        found = np.full((len(xy), len(inverse_depths)), -1.0, np.float32)
        low = self._border - 0.5
        high = np.array([other.camera.width, other.camera.height]) - self._border - 0.5
        for number, place in enumerate(places):
            x, y = place[row, column].T
            inside = (x >= low) & (x < high[0]) & (y >= low) & (y < high[1])
            if not inside.any():
                continue
            seen = cv2.remap(grey, place, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            sums = (seen, seen * seen, self._grey * seen)
            theirs, squares, products = (
                cv2.boxFilter(each, -1, self._window)[row, column] for each in sums
            )
            spread = variance * (squares - theirs**2)
            plain = (variance < _PLAIN**2) | (squares - theirs**2 < _PLAIN**2)
            value = (products - mean * theirs) / np.sqrt(np.where(plain, 1.0, spread))
            found[inside, number] = np.where(plain, 0.0, value)[inside]
        return found

    def _places(self, inverse_depths: Tensor, other: GreyPhotograph) -> NDArray[np.float32]:
        """Return where the picture's pixels lie in another picture, (D, H, W, 2), as OpenCV counts
        pixels, if they show a plane."""
        relative = other.pose @ self._pose.inverse()
        points = self._rays / inverse_depths[:, None, None].double()
        projected = other.camera.project(relative.transform(points.flatten(0, 1)))
        usable = projected.valid & self._valid.repeat(len(inverse_depths))
        xy = torch.where(usable[:, None], projected.xy - 0.5, _NOWHERE)
        nodes = xy.view(len(inverse_depths), *self._cells, 2).float().numpy()
        height, width = self._grey.shape
        size = (self._cells[1] * _CELL, self._cells[0] * _CELL)
        return np.stack(
            [
                cv2.resize(each, size, interpolation=cv2.INTER_LINEAR)[
                    _CELL : _CELL + height, _CELL : _CELL + width
                ]
                for each in nodes
            ]
        )
