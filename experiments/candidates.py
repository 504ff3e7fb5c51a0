"""How often the first and the first eight candidates of a search lie near the truth, by tilt.

    python -m experiments.candidates DATASET [DATASET ...] [--every N] [--cache CACHE]

Queries are searched by ``objconnect`` without a prior. A candidate is *near* within 8 m, 10 degrees
of the reference. Candidates come in lists: those of the objects, of the coarse search, and of the
coarse search at other tilts. The table states, for each list and range of true tilts, the number of
queries whose first candidate is near, or one of the first eight, and the processor seconds a query.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from time import process_time
from typing import Final, NamedTuple

import numpy as np

from experiments.searches import SearchedQuery, measure_searches
from objconnect.localization.coarse.search import Candidate
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import tilt
from objconnect.scene.localizer import Stopwatch

_NEAR_M, _NEAR_DEG = 8.0, 10.0
_FIRST: Final = 8
# Bounds of the ranges of tilts, degrees.
_TILTS_DEG: Final = (0, 10, 20, 30, 40, 50, 60, 90)


class RankedList(NamedTuple):
    """A list of candidates of a query.

    Attributes:
        number: number of the list.
        tilt_deg: true tilt of the query, degrees.
        rank: number of the first near candidate, from 1; infinite if there is none.
        seconds: processor seconds of the list.
    """

    number: int
    tilt_deg: float
    rank: float
    seconds: float


def rank_candidates(candidates: Sequence[Candidate], truth: Pose) -> float:
    """Return the number of the first candidate near the truth, from 1; infinite without one."""
    for number, candidate in enumerate(candidates, 1):
        metres, degrees = candidate.pose.error_to(truth)
        if metres < _NEAR_M and degrees < _NEAR_DEG:
            return number
    return math.inf


def rank_query(searched: SearchedQuery) -> list[RankedList]:
    """Return the lists of candidates of a query."""
    search, query, truth = searched
    degrees = math.degrees(tilt(truth.rotation.numpy()))
    ranked, begin = [], process_time()
    for number, found in enumerate(search.find(query, Stopwatch()), 1):
        rank = rank_candidates(found, truth)
        ranked.append(RankedList(number, degrees, rank, process_time() - begin))
        begin = process_time()
    return ranked


def _print_table(ranked: Sequence[RankedList]) -> None:
    print("| list | tilt, deg | queries | first | first eight | seconds |")
    print("|--:|--:|--:|--:|--:|--:|")
    for number in dict.fromkeys(each.number for each in ranked):
        for low, high in pairwise(_TILTS_DEG):
            some = [r for r in ranked if r.number == number and low <= r.tilt_deg < high]
            if some:
                first = sum(each.rank == 1 for each in some)
                among = sum(each.rank <= _FIRST for each in some)
                seconds = np.median([each.seconds for each in some])
                shown = f"{low} to {high} | {len(some)} | {first} | {among} | {seconds:.2f}"
                print(f"| {number} | {shown} |")


if __name__ == "__main__":
    measured = measure_searches(__doc__, rank_query)
    _print_table([ranked for query in measured for ranked in query])
