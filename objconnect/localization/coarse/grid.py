"""A grid of square cells on the ground of a map, and the height of the map's points in each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

# Share of the points at either end of an axis that are treated as outliers.
_OUTLIERS: Final = 0.005


@dataclass(frozen=True)
class GroundGrid:
    """Cells on the ground, row by row from the south-west corner to the north and east.

    Attributes:
        origin: (2,) world metres, east and north, of the south-west corner.
        cell: side of a cell, metres.
        heights: (H, W) world metres, the median height of the points in each cell; cells without
            a point take the height of the nearest cell that has one.
    """

    origin: NDArray[np.float64]
    cell: float
    heights: NDArray[np.float64]

    @property
    def shape(self) -> tuple[int, int]:
        """Return the numbers of cells to the north and to the east."""
        rows, columns = self.heights.shape
        return rows, columns

    def centres(self) -> NDArray[np.float64]:
        """Return the centre of every cell at its height, (H, W, 3) world metres."""
        rows, columns = self.shape
        east = self.origin[0] + (np.arange(columns) + 0.5) * self.cell
        north = self.origin[1] + (np.arange(rows) + 0.5) * self.cell
        x, y = np.meshgrid(east, north)
        return np.stack([x, y, self.heights], -1)

    def height_at(self, x: float, y: float) -> float:
        """Return the height (world metres) of the cell at a position, or of the nearest cell."""
        rows, columns = self.shape
        column = min(max(math.floor((x - self.origin[0]) / self.cell), 0), columns - 1)
        row = min(max(math.floor((y - self.origin[1]) / self.cell), 0), rows - 1)
        return float(self.heights[row, column])


def ground_grid(xyz: NDArray[np.float64], cell: float) -> GroundGrid:
    """Lay a grid over the points of a map.

    Args:
        xyz: (M, 3) world metres, at least one.
        cell: side of a cell, metres.
    """
    low, high = np.quantile(xyz[:, :2], [_OUTLIERS, 1 - _OUTLIERS], axis=0)
    columns, rows = np.maximum(np.ceil((high - low) / cell), 1).astype(int).tolist()
    column, row = np.floor((xyz[:, :2] - low) / cell).astype(int).T
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    heights = _medians(row[inside] * columns + column[inside], xyz[inside, 2], rows * columns)
    return GroundGrid(low, cell, _fill_gaps(heights.reshape(rows, columns)))


def _medians(
    group: NDArray[np.int64], values: NDArray[np.float64], groups: int
) -> NDArray[np.float64]:
    """Return the (lower) median of each group's values, NaN for groups without one."""
    order = np.lexsort((values, group))
    counts = np.bincount(group, minlength=groups)
    first = np.cumsum(counts) - counts
    medians = np.full(groups, np.nan)
    occupied = counts > 0
    medians[occupied] = values[order][(first + (counts - 1) // 2)[occupied]]
    return medians


def _fill_gaps(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return heights (H, W) with every NaN replaced by the height of the nearest cell with one."""
    empty = np.isnan(heights)
    _, labels = cv2.distanceTransformWithLabels(
        empty.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE, labelType=cv2.DIST_LABEL_PIXEL
    )
    height_of = np.zeros(int(labels.max()) + 1)
    height_of[labels[~empty]] = heights[~empty]
    return np.asarray(height_of[labels])
