"""The landmark nearest to every position, and sums of similarities over objects near landmarks."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

_Complex = NDArray[np.complex128]
_Float = np.float32
_Floats = NDArray[np.float32]
# Side of a cell of the grid of nearest landmarks, metres, and the largest number of cells along an
# axis.
_CELL_M: Final = 1.0
_MOST_CELLS: Final = 4096
# Margin of this grid around the landmarks, metres.
_MARGIN_M: Final = 4.0
# Number of poses that are summed at once, so that their positions stay in the processor's cache.
_BATCH: Final = 16384


class NearestLandmarks:
    """The landmark nearest to every cell of a grid, by a distance transform.

    Args:
        positions: (M,) metres, east + i north.
    """

    def __init__(self, positions: _Complex) -> None:
        xy = np.column_stack([positions.real, positions.imag])
        self._origin = xy.min(0) - _MARGIN_M
        extent = xy.max(0) + _MARGIN_M - self._origin
        self._cell = max(_CELL_M, float(extent.max()) / _MOST_CELLS)
        columns, rows = np.ceil(extent / self._cell).astype(int).tolist()
        column, row = np.floor((xy - self._origin) / self._cell).astype(int).T
        is_empty = np.ones((rows, columns), np.uint8)
        is_empty[row, column] = 0
        _, labels = cv2.distanceTransformWithLabels(
            is_empty, cv2.DIST_L2, cv2.DIST_MASK_PRECISE, labelType=cv2.DIST_LABEL_PIXEL
        )
        landmark = np.zeros(int(labels.max()) + 1, np.int64)
        landmark[labels[row, column]] = np.arange(len(positions))
        # Around the grid is a landmark that is infinitely far. Coordinates count cells from the
        # corner of this border.
        self._padded = np.pad(landmark[labels], 1, constant_values=len(positions))
        self._landmark = self._padded[1:-1, 1:-1]
        in_cells = np.append((xy - self._origin) / self._cell + 1, [[np.inf, np.inf]], axis=0)
        self._east, self._north = np.ascontiguousarray(in_cells.T, np.float32)

    def __call__(self, positions: _Complex) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the rows of the nearest landmarks, and whether the position is in the grid."""
        column = np.floor((positions.real - self._origin[0]) / self._cell).astype(np.int64)
        row = np.floor((positions.imag - self._origin[1]) / self._cell).astype(np.int64)
        rows, columns = self._landmark.shape
        is_inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        nearest = self._landmark[np.where(is_inside, row, 0), np.where(is_inside, column, 0)]
        return nearest, is_inside

    def sum_near(
        self,
        ratio: _Floats,
        offset: _Complex,
        rotation: _Complex,
        position: _Complex,
        sigma_m: float,
    ) -> _Floats:
        """Return for each pose (H,) the sum over objects of their ratio at the nearest landmark.

        Each ratio is multiplied by a Gaussian of the distance from the landmark. An object outside
        the grid counts 0. Sums are in single precision, object by object, which takes a quarter of
        the time of ``__call__`` and double precision.

        Args:
            ratio: (N, M) values of object and landmark.
            offset: (N,) offsets of objects from the camera.
            rotation: (H,) factors from offsets to metres.
            position: (H,) positions of the camera, metres.
            sigma_m: standard deviation of the Gaussian, metres.
        """
        ratios = np.pad(ratio, ((0, 0), (0, 1)))
        offsets = np.stack([offset.real, offset.imag], 1).astype(np.float32)
        relative = (position - complex(*self._origin)) / self._cell + complex(1, 1)
        factor = rotation / self._cell
        parts = (factor.real, factor.imag, relative.real, relative.imag)
        poses = np.stack(parts).astype(np.float32)
        exponent = np.float32(-0.5 * (self._cell / sigma_m) ** 2)
        sums = np.zeros(len(position), np.float32)
        for first in range(0, len(sums), _BATCH):
            part = slice(first, first + _BATCH)
            self._add_part(ratios, offsets, poses[:, part], exponent, sums[part])
        return sums

    def _add_part(
        self, ratios: _Floats, offsets: _Floats, poses: _Floats, exponent: _Float, sums: _Floats
    ) -> None:
        """Add the weighted ratios (N, M + 1) of all objects to the sums (H,) of poses (4, H).

        Arrays are written again for each object, because new ones take half of the time.
        """
        cells, (rows, columns) = self._padded.ravel(), self._padded.shape
        a, b, east, north = np.ascontiguousarray(poses)
        x, y, work = np.empty((3, len(a)), np.float32)
        cell, nearest = np.empty((2, len(a)), np.int64)
        for values, (right, up) in zip(ratios, offsets, strict=True):
            x[:] = east
            x += np.multiply(a, right, out=work)
            x -= np.multiply(b, up, out=work)
            y[:] = north
            y += np.multiply(a, up, out=work)
            y += np.multiply(b, right, out=work)
            cell[:] = np.clip(y, 0, rows - 1, out=work)
            cell *= columns
            nearest[:] = np.clip(x, 0, columns - 1, out=work)
            cell += nearest
            # "clip" skips the check of indices, which are in range.
            np.take(cells, cell, out=nearest, mode="clip")
            x -= np.take(self._east, nearest, out=work, mode="clip")
            y -= np.take(self._north, nearest, out=work, mode="clip")
            np.multiply(x, x, out=x)
            x += np.multiply(y, y, out=y)
            np.exp(np.multiply(x, exponent, out=x), out=x)
            sums += np.multiply(x, np.take(values, nearest, out=work, mode="clip"), out=work)
