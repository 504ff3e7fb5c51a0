"""Figures of some queries of a track, from the results that ``benchmark/tracks/`` keeps.

``uav-seasons/none/objconnect/changed`` names one: the track, the start, the method and the queries.
Words of ``QUERIES_HELP`` choose the queries, joined by ``+``; a fifth part names another figure
than the recall at 0.5 m and 5 degrees, see ``FIGURES`` and ``PAIRED``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmark.report.board.runs import BoardRun, TrackBoard
from benchmark.report.markdown import nees_text
from benchmark.results.query_result import QueryResult
from benchmark.scoring.clustered import permutation_p
from benchmark.scoring.paired import mcnemar
from benchmark.scoring.score import FALSE_FIX, THRESHOLDS, Interval, false_fixes, is_correct, recall
from benchmark.scoring.uncertainty import consistency
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Status

FINE, FOUND = THRESHOLDS[0], THRESHOLDS[1]

_Named = TypeVar("_Named")

QUERIES_HELP: Final = (
    "same, changed or all; snow; a condition, a part or a data set of the track; with:METHOD for "
    "the queries that another method was asked too"
)
# Least p value that is written as a number; below it the sums of a binomial underflow.
_LEAST_P: Final = 1e-300


def percent(share: Interval) -> str:
    """Return a share such as ``96.4 %``."""
    return f"{share.value:.1f} %"


def with_interval(share: Interval) -> str:
    """Return a share with its interval, such as ``96.4 % [95.2, 97.2]``."""
    return f"{percent(share)} [{share.low:.1f}, {share.high:.1f}]"


def p_text(p: float | None) -> str:
    """Return a p value with one digit, such as ``0.02`` or ``6e-14``; a dash for None."""
    if p is None:
        return "–"
    if p < _LEAST_P:
        return f"< {_LEAST_P:.0e}"
    if p >= 0.0001:
        return f"{p:.1g}"
    digit, power = f"{p:.0e}".split("e")
    return f"{digit}e{int(power)}"


def wrong_count(answers: Sequence[QueryResult]) -> int:
    """Return the number of false fixes."""
    return round(false_fixes(answers).value * len(answers) / 100)


def wrong_by(answers: Sequence[QueryResult], metres: float) -> int:
    """Return how many answers of status ``ok`` are wrong by more than so many metres."""
    return sum(a.status is Status.OK and (a.t_err_m or 0.0) > metres for a in answers)


def _nees(answers: Sequence[QueryResult]) -> str:
    found = consistency(answers)
    return "–" if found is None else nees_text(found.mean)


def _within(answers: Sequence[QueryResult]) -> str:
    found = consistency(answers)
    return "–" if found is None else percent(found.within_95)


FIGURES: Final[Mapping[str, Callable[[Sequence[QueryResult]], str]]] = {
    "recall": lambda answers: percent(recall(answers, FOUND)),
    "interval": lambda answers: with_interval(recall(answers, FOUND)),
    "fine": lambda answers: percent(recall(answers, FINE)),
    "coarse": lambda answers: percent(recall(answers, FALSE_FIX)),
    "found": lambda answers: str(sum(is_correct(a, FOUND) for a in answers)),
    "missed": lambda answers: str(sum(not is_correct(a, FOUND) for a in answers)),
    "queries": lambda answers: str(len(answers)),
    "unanswered": lambda answers: str(sum(a.status is not Status.OK for a in answers)),
    "false": lambda answers: str(wrong_count(answers)),
    "false-share": lambda answers: percent(false_fixes(answers)),
    "wrong-1m": lambda answers: str(wrong_by(answers, 1.0)),
    "nees": _nees,
    "within": _within,
}
"""Figures of a method: recall within 0.5 m and 5 degrees alone, with its interval, within 0.25 m
and 2 degrees, within 5 m and 10 degrees; queries found, missed, asked, without an answer; false
fixes as a count and a share; answers wrong by more than 1 m; mean NEES; share of errors in the
95 % ellipsoid."""


class Pair:
    """Two methods on the queries that both were asked.

    Attributes:
        rows: (K,) indices of these queries in the list of the track.
        won: queries that the first method finds within 0.5 m and 5 degrees and the second does not.
        lost: queries that the second one finds and the first does not.
    """

    def __init__(self, board: TrackBoard, first: BoardRun, second: BoardRun, words: str) -> None:
        self.rows = ask(first, second, rows=select(board, words))
        before, after = (run.correct[1, self.rows] for run in (second, first))
        self.won, self.lost = int((after & ~before).sum()), int((before & ~after).sum())
        self._samples = before.tolist(), after.tolist(), board.flights[self.rows].tolist()

    @property
    def p(self) -> float:
        """Return p of McNemar's exact test, two-sided, as if queries were independent."""
        return mcnemar(self.lost, self.won)

    @property
    def flight_p(self) -> float | None:
        """Return p of the test that exchanges the methods flight by flight."""
        return permutation_p(*self._samples)


PAIRED: Final[Mapping[str, Callable[[Pair], str]]] = {
    "won": lambda pair: str(pair.won),
    "lost": lambda pair: str(pair.lost),
    "p": lambda pair: p_text(pair.p),
    "flight-p": lambda pair: p_text(pair.flight_p),
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
        of_pair = known(PAIRED, figure, "paired figure")
        return of_pair(Pair(board, run, run_of(board, start, other), words))
    of_answers = known(FIGURES, figure, "figure")
    return of_answers(run.of(ask(run, rows=select(board, words))))


def known(of: Mapping[str, _Named], name: str, what: str) -> _Named:
    """Return what has a name.

    Raises:
        InputError: nothing has it.
    """
    if name not in of:
        raise InputError(f"there is no {what} {name!r}; there are {', '.join(of)}")
    return of[name]


def track_of(boards: Mapping[str, TrackBoard], name: str) -> TrackBoard:
    """Return the track of a name.

    Raises:
        InputError: there is none.
    """
    return known(boards, name, "track")


def run_of(board: TrackBoard, start: str, method: str) -> BoardRun:
    """Return the answers of a method from a start.

    Raises:
        InputError: the track keeps none.
    """
    runs = {f"{run.start}/{run.method}": run for run in board.runs}
    return known(runs, f"{start}/{method}", f"run of {board.track.name}")


def ask(*runs: BoardRun, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return those of some queries that every method was asked.

    Raises:
        InputError: there is none.
    """
    kept = rows[np.array([run.has[rows] for run in runs]).all(axis=0)]
    if not len(kept):
        methods = " and ".join(run.method for run in runs)
        raise InputError(f"{methods} from {runs[0].start} have no results of the chosen queries")
    return kept


def select(board: TrackBoard, words: str) -> NDArray[np.int64]:
    """Return the indices of the queries that every word chooses, see ``QUERIES_HELP``.

    Raises:
        InputError: a word is unknown, or no query is left.
    """
    chosen = np.ones(len(board.queries), np.bool_)
    for word in words.split("+"):
        chosen &= _chosen_by(board, word)
    rows = np.flatnonzero(chosen)
    if not len(rows):
        raise InputError(f"{board.track.name} has no query that is {words}")
    return rows


def _chosen_by(board: TrackBoard, word: str) -> NDArray[np.bool_]:
    kind, _, method = word.partition(":")
    if kind == "with":
        runs = [run for run in board.runs if run.method == method]
        if not runs:
            raise InputError(f"{board.track.name} has no results of {method!r}")
        return np.array([run.has for run in runs]).any(axis=0)
    flags = []
    for query in board.queries:
        names = {"all", "same" if query.same else "changed", query.dataset}
        names |= {query.row.condition, query.row.part}
        if query.row.condition.startswith("snow"):
            names.add("snow")
        flags.append(word in names)
    if not any(flags):
        raise InputError(f"{board.track.name} has no queries {word!r}: it takes {QUERIES_HELP}")
    return np.array(flags, np.bool_)
