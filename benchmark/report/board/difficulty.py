"""Recall against what makes a query difficult: overlap, scale, view angle and time of year.

The difficulty of a query is stated by its track, from the reference poses and the map alone, so
that it is the same for every method; see ``benchmark.tracks.difficulty``. A query is compared with
its best map photograph, which sees most of its surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmark.scoring.intervals import Interval, number_clusters, share_of_counts


@dataclass(frozen=True)
class Axis:
    """One kind of difficulty and its bins.

    Attributes:
        key: attribute of ``benchmark.tracks.difficulty.Difficulty``.
        short: its name in a word or two.
        column: heading of a column of its values.
        title: description of the difficulty in one phrase.
        unit: unit of the labels.
        edges: edges of the bins, in the unit of the attribute; overlap is a share of 1, not in %. A
            bin holds its lower edge and not its upper one; the last holds both.
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
        array = np.array([np.nan if value is None else value for value in values], np.float64)
        bins = np.searchsorted(self.edges, array, side="right") - 1
        bins[array == self.edges[-1]] = len(self.labels) - 1
        inside = (array >= self.edges[0]) & (array <= self.edges[-1])
        return np.where(inside, bins, -1)


AXES: Final = (
    Axis(
        "overlap",
        "overlap",
        "overlap",
        "Share of the query that is also in its best map photograph, the one that sees most of it.",
        "%",
        (0, 0.2, 0.4, 0.6, 0.8, 1),
        ("0–20", "20–40", "40–60", "60–80", "80–100"),
    ),
    Axis(
        "scale",
        "scale",
        "scale",
        "Ground sampling distance of the query divided by that of its best map photograph.",
        "ratio",
        (0, 0.5, 0.71, 1, 1.41, 2, np.inf),
        ("< 0.5", "0.5–0.71", "0.71–1", "1–1.41", "1.41–2", "≥ 2"),
    ),
    Axis(
        "angle_deg",
        "view angle",
        "view °",
        "Angle between the lines of sight from both photographs to the same ground.",
        "degrees",
        (0, 10, 20, 30, 45, 60, 180),
        ("0–10", "10–20", "20–30", "30–45", "45–60", "≥ 60"),
    ),
    Axis(
        "days",
        "time of year",
        "days",
        "Days of the year between the query and its best map photograph.",
        "days",
        (0, 30, 60, 90, 120, 150, 182),
        ("0–30", "30–60", "60–90", "90–120", "120–150", "150–182"),
    ),
)


class Bin(NamedTuple):
    """The queries of a bin and their recall; None where there is no query."""

    queries: int
    recall: Interval | None


def bin_recall(
    bins: NDArray[np.int64], correct: NDArray[np.bool_], courses: Sequence[str], count: int
) -> list[Bin]:
    """Return the recall of each of ``count`` bins.

    Args:
        bins: (N,) bin of each query, -1 for none.
        correct: (N,) whether it is correct.
        courses: flight path of each query; repeated flights share one.
        count: number of bins.
    """
    course = number_clusters(courses)
    shape = count, int(course.max(initial=-1)) + 1
    has_bin = bins >= 0
    cell = np.ravel_multi_index((bins[has_bin], course[has_bin]), shape)
    total = np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape)
    right = np.bincount(cell, correct[has_bin], shape[0] * shape[1]).reshape(shape)
    return [
        Bin(int(n.sum()), share_of_counts(k[n > 0], n[n > 0]) if n.any() else None)
        for n, k in zip(total, right, strict=True)
    ]
