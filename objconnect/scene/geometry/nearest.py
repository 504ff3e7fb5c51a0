"""Nearest neighbours among many points on a plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class NearestNeighbours:
    """A nearest-neighbour index of points (N, 2), which it sorts by x.

    A query computes distances only to the points in a strip of x. At constant density, a strip has
    about as many points as the square root of their number.
    """

    def __init__(self, xy: NDArray[np.float64]) -> None:
        self._rows = np.argsort(xy[:, 0], kind="stable")
        self._xy = xy[self._rows]

    def __call__(self, point: NDArray[np.float64], k: int) -> NDArray[np.int64]:
        """Return the rows of the ``k`` points nearest to ``point`` (2,), nearest first.

        Points at equal distance are ordered by row.

        Raises:
            ValueError: the point is not finite.
        """
        if not np.isfinite(point).all():
            raise ValueError(f"the point must be finite, got {point}")
        # Points are sorted by x, so those within a radius lie in one range of rows.
        sorted_x, count = self._xy[:, 0], len(self._xy)
        k = min(k, count)
        if not k:
            return np.zeros(0, np.int64)
        # Start with a strip of at least k points, and double it until k are in the circle.
        position = int(sorted_x.searchsorted(point[0]))
        ends = sorted_x[[max(0, position - k), min(count, position + k) - 1]]
        radius = float(np.abs(ends - point[0]).max())
        while True:
            begin = int(sorted_x.searchsorted(point[0] - radius))
            end = int(sorted_x.searchsorted(point[0] + radius, "right"))
            squares = np.square(self._xy[begin:end] - point).sum(1)
            inside = np.flatnonzero(squares <= radius * radius)  # ** raises OverflowError instead
            if end - begin == count:
                inside = np.arange(count)
            if len(inside) >= k:
                break
            radius = 2 * radius or 1e-6
        if len(inside) > k:
            kth_square = np.partition(squares[inside], k - 1)[k - 1]
            inside = inside[squares[inside] <= kth_square]
        rows = self._rows[begin:end][inside]
        return np.asarray(rows[np.lexsort((rows, squares[inside]))][:k], np.int64)

    def within(self, point: NDArray[np.float64], radius: float) -> NDArray[np.int64]:
        """Return the rows of the points at most ``radius`` from ``point`` (2,), ascending."""
        sorted_x = self._xy[:, 0]
        begin = int(sorted_x.searchsorted(point[0] - radius))
        end = int(sorted_x.searchsorted(point[0] + radius, "right"))
        distances = np.linalg.norm(self._xy[begin:end] - point, axis=1)
        return np.sort(self._rows[begin:end][distances <= radius])
