"""A spatial index of circles with constant look-up time."""

from __future__ import annotations

from collections import defaultdict
from math import floor

import numpy as np
from numpy.typing import NDArray

_CELL_M = 16.0


class CircleGrid:
    """Circles in the cells of a square grid, numbered in order of insertion."""

    def __init__(self) -> None:
        self._circles: list[tuple[float, float, float]] = []
        self._cells: defaultdict[tuple[int, int], list[int]] = defaultdict(list)

    def add(self, centre: NDArray[np.float64], radius: float) -> None:
        """Add a circle with a centre (2,) and a radius, metres."""
        x, y = centre.tolist()
        for cell in _cells(x, y, radius):
            self._cells[cell].append(len(self._circles))
        self._circles.append((x, y, float(radius)))

    def find_overlapping(self, centre: NDArray[np.float64], radius: float) -> list[int]:
        """Return the numbers of the circles that overlap a given circle, ascending.

        The given circle has a centre (2,) and a radius, metres.
        """
        x, y = centre.tolist()
        candidates = {k for cell in _cells(x, y, radius) for k in self._cells.get(cell, ())}
        neighbours = []
        for k in sorted(candidates):
            cx, cy, r = self._circles[k]
            if (cx - x) ** 2 + (cy - y) ** 2 < (r + radius) ** 2:
                neighbours.append(k)
        return neighbours


def _cells(x: float, y: float, radius: float) -> list[tuple[int, int]]:
    """Return the cells that a circle's bounding square touches."""
    columns = range(floor((x - radius) / _CELL_M), floor((x + radius) / _CELL_M) + 1)
    rows = range(floor((y - radius) / _CELL_M), floor((y + radius) / _CELL_M) + 1)
    return [(i, j) for i in columns for j in rows]
