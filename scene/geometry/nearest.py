"""The nearest of many places on a plane, without looking at all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Nearest:
    """Places sorted by their first coordinate, of which a query looks at a strip.

    In a map a hundred times as large it holds ten times as many.

    Args:
        xy: (N, 2).
    """

    def __init__(self, xy: NDArray[np.float64]) -> None:
        self._rows = np.argsort(xy[:, 0], kind="stable")
        self._xy = xy[self._rows]

    def __call__(self, place: NDArray[np.float64], k: int) -> NDArray[np.int64]:
        """Rows of the ``k`` places nearest to one (2,), nearest first, of equals the first.

        Raises:
            ValueError: the place is not finite.
        """
        if not np.isfinite(place).all():
            raise ValueError(f"no place: {place}")
        first, count = self._xy[:, 0], len(self._xy)
        k = min(k, count)
        if not k:
            return np.zeros(0, np.int64)
        # A strip that holds so many, wherever in it they are.
        at = int(first.searchsorted(place[0]))
        ends = first[[max(0, at - k), min(count, at + k) - 1]]
        reach = float(np.abs(ends - place[0]).max())
        while True:
            begin = int(first.searchsorted(place[0] - reach))
            end = int(first.searchsorted(place[0] + reach, "right"))
            squares = np.square(self._xy[begin:end] - place).sum(1)
            within = np.flatnonzero(squares <= reach * reach)  # ** of a large one is an error
            if end - begin == count:
                within = np.arange(count)
            if len(within) >= k:
                break
            reach = 2 * reach or 1e-6
        if len(within) > k:
            least = np.partition(squares[within], k - 1)[k - 1]
            within = within[squares[within] <= least]
        rows = self._rows[begin:end][within]
        return np.asarray(rows[np.lexsort((rows, squares[within]))][:k], np.int64)
