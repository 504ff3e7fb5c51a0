"""The cells of a track: the groups of queries that one figure pools.

A cell is a season and a part of the track. The seasons are "same" (the map's own condition, and
nothing moved), "changed" (all others), and each condition. The parts are "all" and each part of the
track, such as a kind of place; a single condition is pooled over all parts only.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.report.board.runs import BoardQuery
from benchmark.scoring.score import Interval, Threshold, is_correct, wilson
from benchmark.scoring.uncertainty import Predicted, doubt
from benchmark.tracks.queries import CHANGED, SAME
from objconnect.scene.bundle.manifest import ALL_CONDITIONS

ALL: Final = ALL_CONDITIONS
# Recall at which the width of a cell's intervals is stated.
_RECALL: Final = 0.9
RISK: Final = 0.01
"""Upper bound of the share of wrong answers in ``recall_at_risk``."""


@dataclass(frozen=True, eq=False)
class Cell:
    """The queries of one cell.

    Attributes:
        season: "same", "changed" or a condition.
        part: "all" or a part of the track.
        rows: (K,) indices of the queries in the list of the track.
    """

    season: str
    part: str
    rows: NDArray[np.int64]

    @property
    def half_width(self) -> float:
        """Half the width of a 95 % interval at a recall of 90 %, in percentage points."""
        low, high = wilson(round(_RECALL * len(self.rows)), len(self.rows))
        return 50 * (high - low)


def cells(queries: Sequence[BoardQuery]) -> Iterator[Cell]:
    """Yield the cells with queries: both seasons of all and of each part, then the conditions."""
    for season in (CHANGED, SAME):
        chosen = [k for k, query in enumerate(queries) if query.same == (season == SAME)]
        for part in (ALL, *parts(queries)):
            rows = [k for k in chosen if part in (ALL, queries[k].row.part)]
            if rows:
                yield Cell(season, part, np.array(rows))
    for condition in conditions(queries):
        rows = [k for k, query in enumerate(queries) if query.row.condition == condition]
        yield Cell(condition, ALL, np.array(rows))


def parts(queries: Sequence[BoardQuery]) -> tuple[str, ...]:
    """Return the parts of a track in the order of its sites."""
    return tuple(dict.fromkeys(query.row.part for query in queries))


def conditions(queries: Sequence[BoardQuery]) -> tuple[str, ...]:
    """Return the conditions of a track in the order of its queries."""
    return tuple(dict.fromkeys(query.row.condition for query in queries))


def recall_at_risk(outcomes: Sequence[Predicted], threshold: Threshold) -> Interval | None:
    """Return the recall of the most certain answers, of which fewer than 1 % are wrong.

    Answers are accepted in the order of ``uncertainty.doubt``, as long as the share of wrong poses
    among them is below ``RISK``. Ties are accepted together. An answer without a probability and a
    standard deviation is never accepted.

    Returns:
        The share of all queries that are accepted and correct, in percent; None if no answer has a
        probability or a standard deviation.
    """
    stated = sorted((o for o in outcomes if min(doubt(o)) < np.inf), key=doubt)
    if not stated:
        return None
    correct = np.cumsum([is_correct(o, threshold) for o in stated])
    accepted = np.arange(1, len(stated) + 1)
    # A set of accepted answers may end only at the last of several ties.
    doubts = [doubt(o) for o in stated]
    closed = np.array([a != b for a, b in pairwise([*doubts, None])])
    allowed = np.flatnonzero(closed & (accepted - correct < RISK * accepted))
    count = int(correct[allowed[-1]]) if len(allowed) else 0
    low, high = wilson(count, len(outcomes))
    return Interval(100 * count / len(outcomes), 100 * low, 100 * high)
