"""Figures of chosen queries of a track, from the results that ``benchmark/tracks/`` keeps.

``uav-seasons/none/objconnect/changed`` names one figure by track, start, method and queries.
Words of ``QUERIES_HELP`` choose the queries, joined by ``+``; a fifth part names another figure
than the recall at 0.5 m and 5 degrees, see ``FIGURES``, ``PLACES`` and ``PAIRED``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmark.report.board.pairing import reason_against
from benchmark.report.board.runs import BoardRun, TrackBoard
from benchmark.report.markdown import nees_text
from benchmark.results.query_result import QueryResult
from benchmark.scoring.clustered import permutation_p
from benchmark.scoring.intervals import Interval
from benchmark.scoring.score import (
    FALSE_FIX,
    THRESHOLDS,
    false_fixes,
    is_correct,
    is_worse_than_prior,
    is_wrong,
    recall,
    worse_than_prior,
    wrong_answers,
)
from benchmark.scoring.uncertainty import consistency
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Status

FINE, FOUND = THRESHOLDS[0], THRESHOLDS[1]
"""Thresholds of recall: 0.25 m and 2 degrees, 0.5 m and 5 degrees."""

_Named = TypeVar("_Named")

QUERIES_HELP: Final = (
    "same, changed or all; seen, unseen-condition, unseen-place or unseen-both; snow; a condition, "
    "a part or a data set of the track; with:METHOD for the queries that another method was given "
    "too"
)
# Smallest p value that is written as a number; below it the sums of a binomial underflow.
_MIN_P: Final = 1e-300


def percent(share: Interval) -> str:
    """Return a share such as ``96.4 %``."""
    return f"{share.value:.1f} %"


def share_with_interval(share: Interval) -> str:
    """Return a share with its interval by course, such as ``96.4 % [95.2, 97.2]``."""
    return share.text().replace(" [", " % [")


def p_text(p: float | None) -> str:
    """Return a p value with one digit, such as ``0.02`` or ``6e-14``; a dash for None."""
    if p is None:
        return "–"
    if p < _MIN_P:
        return f"< {_MIN_P:.0e}"
    if p >= 0.0001:
        return f"{p:.1g}"
    digit, power = f"{p:.0e}".split("e")
    return f"{digit}e{int(power)}"


def count_false_fixes(answers: Sequence[QueryResult]) -> int:
    """Return the number of false fixes."""
    return round(false_fixes(answers).value * len(answers) / 100)


def count_courses(answers: Sequence[QueryResult]) -> int:
    """Return the number of courses of the queries."""
    return len({answer.course_name for answer in answers})


def _worse_share(answers: Sequence[QueryResult]) -> str:
    found = worse_than_prior(answers)
    return "–" if found is None else percent(found)


def _nees(answers: Sequence[QueryResult]) -> str:
    found = consistency(answers)
    return "–" if found is None else nees_text(found.mean)


def _ellipsoid_share(answers: Sequence[QueryResult]) -> str:
    found = consistency(answers)
    return "–" if found is None else percent(found.within_95)


FIGURES: Final[Mapping[str, Callable[[Sequence[QueryResult]], str]]] = {
    "recall": lambda answers: percent(recall(answers, FOUND)),
    "interval": lambda answers: share_with_interval(recall(answers, FOUND)),
    "fine": lambda answers: percent(recall(answers, FINE)),
    "coarse": lambda answers: percent(recall(answers, FALSE_FIX)),
    "found": lambda answers: str(sum(is_correct(a, FOUND) for a in answers)),
    "missed": lambda answers: str(sum(not is_correct(a, FOUND) for a in answers)),
    "queries": lambda answers: str(len(answers)),
    "courses": lambda answers: str(count_courses(answers)),
    "unanswered": lambda answers: str(sum(a.status is not Status.OK for a in answers)),
    "false": lambda answers: str(count_false_fixes(answers)),
    "false-share": lambda answers: percent(false_fixes(answers)),
    "wrong-1m": lambda answers: str(sum(is_wrong(a) for a in answers)),
    "wrong-1m-share": lambda answers: percent(wrong_answers(answers)),
    "worse": lambda answers: str(sum(is_worse_than_prior(a) for a in answers)),
    "worse-share": _worse_share,
    "nees": _nees,
    "within": _ellipsoid_share,
}
"""Figures of a method: recall within 0.5 m and 5 degrees alone, with its interval, within 0.25 m
and 2 degrees, within 5 m and 10 degrees; queries found, missed, given, their courses, queries
without an answer; false fixes, answers wrong by more than 1 m, and answers worse than their prior,
each as a count and a share; mean NEES; share of errors in the 95 % ellipsoid."""

PLACES: Final = "places"
"""The figure that counts the places of the queries."""


class Pair:
    """Two methods on the queries that both were given.

    Attributes:
        rows: (K,) indices of these queries in the list of the track.
        won: queries that the first method finds within 0.5 m and 5 degrees and the second does not.
        lost: queries that the second one finds and the first does not.
    """

    def __init__(self, board: TrackBoard, first: BoardRun, second: BoardRun, words: str) -> None:
        self.rows = shared_queries(first, second, rows=select(board, words))
        datasets = {board.queries[row].dataset for row in self.rows}
        if reason := reason_against(board.track.controls, first, second, sorted(datasets)):
            raise InputError(f"{first.method} and {second.method} are not compared: {reason}")
        by_first, by_second = (run.correct[1, self.rows] for run in (first, second))
        self.won = int((by_first & ~by_second).sum())
        self.lost = int((by_second & ~by_first).sum())
        self._samples = by_second.tolist(), by_first.tolist(), board.courses[self.rows].tolist()

    @property
    def p(self) -> float | None:
        """Return p of the test that exchanges the methods course by course."""
        return permutation_p(*self._samples)


PAIRED: Final[Mapping[str, Callable[[Pair], str]]] = {
    "won": lambda pair: str(pair.won),
    "lost": lambda pair: str(pair.lost),
    "p": lambda pair: p_text(pair.p),
}
"""Figures of a method against another one, named as ``won=sift``."""


def value(boards: Mapping[str, TrackBoard], name: str) -> str:
    """Return the figure of a name.

    Args:
        boards: tracks with their results, by name.
        name: ``TRACK/START/METHOD/QUERIES`` or ``TRACK/START/METHOD/QUERIES/FIGURE``.

    Raises:
        InputError: a part of the name is unknown, or no query is chosen.
    """
    parts = name.split("/")
    if len(parts) not in (4, 5):
        raise InputError(f"figure {name!r} is not TRACK/START/METHOD/QUERIES[/FIGURE]")
    track, start, method, words = parts[:4]
    figure, _, other = (parts[4] if len(parts) == 5 else "recall").partition("=")
    board = track_of(boards, track)
    run = run_of(board, start, method)
    if other:
        pair_figure = look_up(PAIRED, figure, "paired figure")
        return pair_figure(Pair(board, run, run_of(board, start, other), words))
    rows = shared_queries(run, rows=select(board, words))
    if figure == PLACES:
        return str(len(board.datasets_at(rows)))
    answers_figure = look_up(FIGURES, figure, "figure")
    return answers_figure(run.answers_at(rows))


def look_up(entries: Mapping[str, _Named], name: str, kind: str) -> _Named:
    """Return the entry of a name.

    Raises:
        InputError: there is none.
    """
    if name not in entries:
        raise InputError(f"there is no {kind} {name!r}; there are {', '.join(entries)}")
    return entries[name]


def track_of(boards: Mapping[str, TrackBoard], name: str) -> TrackBoard:
    """Return the track of a name.

    Raises:
        InputError: there is none.
    """
    return look_up(boards, name, "track")


def run_of(board: TrackBoard, start: str, method: str) -> BoardRun:
    """Return the answers of a method from a start.

    Raises:
        InputError: the track keeps none.
    """
    runs = {f"{run.start}/{run.method}": run for run in board.runs}
    return look_up(runs, f"{start}/{method}", f"run of {board.track.name}")


def shared_queries(*runs: BoardRun, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the queries among ``rows`` that every method was given.

    Raises:
        InputError: there is none.
    """
    shared_rows = rows[np.array([run.has[rows] for run in runs]).all(axis=0)]
    if not len(shared_rows):
        methods = " and ".join(run.method for run in runs)
        raise InputError(f"{methods} from {runs[0].start} have no results of the chosen queries")
    return shared_rows


def select(board: TrackBoard, words: str) -> NDArray[np.int64]:
    """Return the indices of the queries that every word chooses, see ``QUERIES_HELP``.

    Raises:
        InputError: a word is unknown, or no query is left.
    """
    chosen = np.ones(len(board.queries), np.bool_)
    for word in words.split("+"):
        chosen &= _select_by_word(board, word)
    rows = np.flatnonzero(chosen)
    if not len(rows):
        raise InputError(f"{board.track.name} has no query that is {words}")
    return rows


def _select_by_word(board: TrackBoard, word: str) -> NDArray[np.bool_]:
    kind, _, method = word.partition(":")
    if kind == "with":
        runs = [run for run in board.runs if run.method == method]
        if not runs:
            raise InputError(f"{board.track.name} has no results of {method!r}")
        return np.array([run.has for run in runs]).any(axis=0)
    flags = []
    for query in board.queries:
        names = {"all", "same" if query.same else "changed", query.dataset, query.novelty}
        names |= {query.row.condition, query.row.part}
        if query.row.condition.startswith("snow"):
            names.add("snow")
        flags.append(word in names)
    if not any(flags):
        raise InputError(f"{board.track.name} has no queries {word!r}: it takes {QUERIES_HELP}")
    return np.array(flags, np.bool_)
