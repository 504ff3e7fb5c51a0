"""The cells of a benchmark track: groups of queries whose results are pooled.

A cell is one season and one part of the track, such as a kind of site. The seasons are:

- "same": queries under the map's own condition, where nothing moved;
- "changed": all other queries;
- "seen", "unseen-condition", "unseen-place" and "unseen-both": the changed queries by what their
  track holds out of training, if it holds out conditions or presets;
- each condition.

The parts are "all" and each part of the track. Only the seasons "same" and "changed" are divided
into parts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.report.board.runs import BoardQuery, BoardRun
from benchmark.scoring.intervals import Interval, share
from benchmark.scoring.score import Threshold, is_correct
from benchmark.scoring.uncertainty import PredictedOutcome, doubt
from benchmark.tracks.queries import CHANGED, SAME, SEEN, UNSEEN
from objconnect.scene.bundle.manifest import ALL_CONDITIONS

ALL: Final = ALL_CONDITIONS
RISK: Final = 0.01
"""Upper bound of the share of wrong answers in ``recall_at_risk``."""


@dataclass(frozen=True, eq=False)
class Cell:
    """The queries of one cell.

    Attributes:
        season: "same", "changed", "seen", one of ``UNSEEN`` or a condition.
        part: "all" or a part of the track.
        rows: (K,) indices of the queries in the list of the track.
    """

    season: str
    part: str
    rows: NDArray[np.int64]


def cells(queries: Sequence[BoardQuery]) -> Iterator[Cell]:
    """Yield the cells that have queries: "changed" and "same", each for all parts and for each
    part; then "seen" and the unseen ones; then the conditions."""
    for season in (CHANGED, SAME):
        chosen = [k for k, query in enumerate(queries) if query.same == (season == SAME)]
        for part in (ALL, *parts(queries)):
            rows = [k for k in chosen if part in (ALL, queries[k].row.part)]
            if rows:
                yield Cell(season, part, np.array(rows))
    for novelty in (SEEN, *UNSEEN):
        rows = [k for k, query in enumerate(queries) if query.novelty == novelty and not query.same]
        if rows:
            yield Cell(novelty, ALL, np.array(rows))
    for condition in conditions(queries):
        rows = [k for k, query in enumerate(queries) if query.row.condition == condition]
        yield Cell(condition, ALL, np.array(rows))


def shared_cells(queries: Sequence[BoardQuery], runs: Sequence[BoardRun]) -> Iterator[Cell]:
    """Yield the cells, each with only those queries for which every run has a result.

    A cell without such queries is left out. If all runs have the same queries, nothing is yielded.
    """
    shared = np.array([run.has for run in runs]).all(axis=0)
    if np.array_equal(shared, np.array([run.has for run in runs]).any(axis=0)):
        return
    for cell in cells(queries):
        if len(rows := cell.rows[shared[cell.rows]]):
            yield Cell(cell.season, cell.part, rows)


def parts(queries: Sequence[BoardQuery]) -> tuple[str, ...]:
    """Return the parts of a track in the order of its places."""
    return tuple(dict.fromkeys(query.row.part for query in queries))


def conditions(queries: Sequence[BoardQuery]) -> tuple[str, ...]:
    """Return the conditions of a track in the order of its queries."""
    return tuple(dict.fromkeys(query.row.condition for query in queries))


def recall_at_risk(outcomes: Sequence[PredictedOutcome], threshold: Threshold) -> Interval | None:
    """Return the recall at bounded risk: only the most certain answers count as found.

    Answers are ranked by ``uncertainty.doubt``. As many of the first answers as possible are
    accepted, with a share of wrong poses below ``RISK``; ties are accepted together. An answer that
    has neither a probability nor a standard deviation is never accepted.

    Returns:
        The share of all queries that are accepted and correct, in percent; None if no answer has a
        probability or a standard deviation.
    """
    ranked = sorted(outcomes, key=doubt)
    # Answers with a probability or a standard deviation come first in the order of doubt.
    certain = [o for o in ranked if min(doubt(o)) < np.inf]
    if not certain:
        return None
    is_right = np.array([is_correct(o, threshold) for o in ranked])
    correct_count = np.cumsum(is_right[: len(certain)])
    accepted_count = np.arange(1, len(certain) + 1)
    # If one of several tied answers is accepted, all of them are.
    doubts = [doubt(o) for o in certain]
    ends_tie = np.array([a != b for a, b in pairwise([*doubts, None])])
    allowed = np.flatnonzero(ends_tie & (accepted_count - correct_count < RISK * accepted_count))
    is_right[allowed[-1] + 1 if len(allowed) else 0 :] = False
    return share(is_right, [o.course_name for o in ranked])
