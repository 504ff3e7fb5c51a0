"""Recall against what makes a query difficult: overlap, scale, view angle and time of year.

The difficulty of a query is stated by its track, from the reference poses and the map alone, so
that it is the same for every method; see ``benchmark.tracks.difficulty``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmark.scoring.score import Interval, wilson


@dataclass(frozen=True)
class Axis:
    """One kind of difficulty and its bins.

    Attributes:
        key: attribute of ``benchmark.tracks.difficulty.Difficulty``.
        short: its name in a word or two.
        column: heading of a column of its values.
        title: what it is, in a phrase.
        unit: its unit.
        edges: edges of the bins. A bin holds its lower edge and not its upper one; the last holds
            both.
        labels: name of each bin.
    """

    key: str
    short: str
    column: str
    title: str
    unit: str
    edges: tuple[float, ...]
    labels: tuple[str, ...]

    def bins(self, values: Sequence[float | None]) -> NDArray[np.int64]:
        """Return the bin of each value; -1 where it is unknown or outside the edges."""
        known = np.array([np.nan if value is None else value for value in values], np.float64)
        found = np.searchsorted(self.edges, known, side="right") - 1
        found[known == self.edges[-1]] = len(self.labels) - 1
        outside = ~((known >= self.edges[0]) & (known <= self.edges[-1]))
        return np.where(outside, -1, found)


AXES: Final = (
    Axis(
        "overlap",
        "overlap",
        "overlap",
        "Share of the query that the map photograph sees too.",
        "%",
        (0, 0.2, 0.4, 0.6, 0.8, 1),
        ("0–20", "20–40", "40–60", "60–80", "80–100"),
    ),
    Axis(
        "scale",
        "scale",
        "scale",
        "Size of the query's pixels on the ground over that of the map photograph's.",
        "ratio",
        (0, 0.5, 0.71, 1, 1.41, 2, np.inf),
        ("< 0.5", "0.5–0.71", "0.71–1", "1–1.41", "1.41–2", "> 2"),
    ),
    Axis(
        "angle_deg",
        "view angle",
        "view °",
        "Angle between the lines of sight from both to the same ground.",
        "degrees",
        (0, 10, 20, 30, 45, 60, 180),
        ("0–10", "10–20", "20–30", "30–45", "45–60", "> 60"),
    ),
    Axis(
        "days",
        "time of year",
        "days",
        "Days of the year between the map photograph and the query.",
        "days",
        (0, 30, 60, 90, 120, 150, 182),
        ("0–30", "30–60", "60–90", "90–120", "120–150", "150–182"),
    ),
)


class Bin(NamedTuple):
    """The queries of a bin and their recall; None where there is no query."""

    queries: int
    recall: Interval | None


def bin_recall(bins: NDArray[np.int64], correct: NDArray[np.bool_], count: int) -> list[Bin]:
    """Return the recall of each of ``count`` bins.

    Args:
        bins: (N,) bin of each query, -1 for none.
        correct: (N,) whether it is correct.
        count: number of bins.
    """
    kept = bins >= 0
    total = np.bincount(bins[kept], minlength=count)
    right = np.bincount(bins[kept & correct], minlength=count)
    return [Bin(int(n), _share(int(k), int(n))) for n, k in zip(total, right, strict=True)]


def _share(right: int, total: int) -> Interval | None:
    if not total:
        return None
    low, high = wilson(right, total)
    return Interval(100 * right / total, 100 * low, 100 * high)
