"""Tables of the stored results for the documents, as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import sqrt
from statistics import stdev
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.report.board.cells import conditions, parts
from benchmark.report.board.runs import BoardRun, TrackBoard
from benchmark.report.markdown import line
from benchmark.results.query_result import QueryResult
from benchmark.scoring.score import Interval, false_fixes, recall
from benchmark.scoring.uncertainty import consistency
from experiments.figure_values import (
    FOUND,
    ask,
    known,
    percent,
    select,
    track_of,
    wrong_count,
)
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Status

Boards = Mapping[str, TrackBoard]

# The columns of the table of methods: starts, and the prior that each gives a method.
_PRIORS: Final = {
    "error=3m,5deg": "prior off by 3 m, 5°",
    "gps=50m": "position off by 50 m, no heading",
    "none": "no prior",
}
_TRACK: Final = "uav-seasons"


def methods(boards: Boards) -> str:
    """Return the table of README: recall of all methods by the prior.

    Each column holds the changed queries of ``uav-seasons`` on the places that all methods with
    results from that start share. Stored results have no comparable seconds: they were timed on
    different days, beside other work.
    """
    board = track_of(boards, _TRACK)
    rows = {start: _shared(board, start) for start in _PRIORS}
    head = [f"{prior} ({len(rows[start])})" for start, prior in _PRIORS.items()]
    lines = [["method", *head, "false fixes"]]
    for method in board.track.methods:
        runs = {run.start: run for run in board.runs if run.method == method}
        answers = [runs[s].of(rows[s]) if s in runs else None for s in _PRIORS]
        recalls = ["–" if a is None else _cell(recall(a, FOUND)) for a in answers]
        wrong = ["–" if a is None else str(wrong_count(a)) for a in answers]
        lines.append([f"`{method}`", *recalls, ", ".join(wrong)])
    return _markdown(lines)


def recall_by(boards: Boards, track: str, start: str, by: str, season: str = "changed") -> str:
    """Return recall at 0.5 m and 5 degrees: a column for each method, intervals in the last row.

    Args:
        boards: tracks with their results.
        track: name of the track.
        start: name of the start.
        by: what has a row of its own: ``part`` or ``condition``.
        season: words that choose the queries.

    Raises:
        InputError: a name is unknown.
    """
    board = track_of(boards, track)
    runs = _runs(board, start)
    lines = [["", *(f"`{run.method}`" for run in runs)]]
    for name in _row_names(board, by, season):
        lines.append(_row(name, runs, select(board, f"{season}+{name}"), _short))
    everything = select(board, season)
    lines.append(_row("all", runs, everything, _cell))
    lines.append(["false fixes", *(_wrong_of(run, everything) for run in runs)])
    return _markdown(lines)


def covariances(boards: Boards, track: str, method: str) -> str:
    """Return how a method's errors compare with its covariances, by condition and start.

    Cells hold the mean NEES with its standard error, and the percentage in the 95 % ellipsoid.

    Raises:
        InputError: a name is unknown.
    """
    board = track_of(boards, track)
    runs = [run for run in board.runs if run.method == method]
    lines = [["", *(f"`{run.start}`" for run in runs)]]
    for name in ("all", *conditions(board.queries)):
        rows = select(board, name)
        lines.append([name, *(_consistency(run.of(rows)) for run in runs)])
    return _markdown(lines)


TABLES: Final[Mapping[str, Callable[..., str]]] = {
    "methods": methods,
    "recall": recall_by,
    "covariances": covariances,
}
"""Each table by the first word of its comment; the other words are its arguments."""


def table(boards: Boards, words: str) -> str:
    """Return the table of a comment such as ``recall uav-seasons none part``.

    Raises:
        InputError: a word is unknown, or there are too many or too few.
    """
    name, *arguments = words.split()
    make = known(TABLES, name, "table")
    try:
        return make(boards, *arguments)
    except TypeError as error:
        raise InputError(f"table {words!r}: {error}") from None


def _asked_by_any(runs: Sequence[BoardRun], rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return those of some queries that at least one method was asked."""
    return rows[np.array([run.has[rows] for run in runs]).any(axis=0)]


def _shared(board: TrackBoard, start: str) -> NDArray[np.int64]:
    """Return the changed queries that all methods with results from a start were asked."""
    return ask(*_runs(board, start), rows=select(board, "changed"))


def _runs(board: TrackBoard, start: str) -> list[BoardRun]:
    found = [run for run in board.runs if run.start == start]
    if not found:
        raise InputError(f"{board.track.name} keeps no results from start {start!r}")
    return found


def _row_names(board: TrackBoard, by: str, season: str) -> tuple[str, ...]:
    names = {
        "part": parts(board.queries),
        "condition": conditions([board.queries[row] for row in select(board, season)]),
    }
    return known(names, by, "kind of row")


def _row(
    name: str, runs: Sequence[BoardRun], rows: NDArray[np.int64], text: Callable[[Interval], str]
) -> list[str]:
    """Return a row of recalls. A method that was asked fewer queries than others says how many."""
    shown = len(_asked_by_any(runs, rows))
    cells = [f"{name} ({shown})"]
    for answers in (run.of(rows) for run in runs):
        cell = text(recall(answers, FOUND)) if answers else "–"
        cells.append(cell if len(answers) in (0, shown) else f"{cell} of {len(answers)}")
    return cells


def _wrong_of(run: BoardRun, rows: NDArray[np.int64]) -> str:
    answers = run.of(rows)
    return f"{wrong_count(answers)} ({percent(false_fixes(answers))})"


def _consistency(answers: Sequence[QueryResult]) -> str:
    found = consistency(answers)
    if found is None or found.queries < 2:
        return "–"
    values = [a.nees for a in answers if a.status is Status.OK and a.nees is not None]
    error = stdev(values) / sqrt(len(values))
    return f"{found.mean:.2f}±{error:.2f}, {found.within_95.value:.1f}"


def _short(share: Interval) -> str:
    return f"{share.value:.1f}"


def _cell(share: Interval) -> str:
    """Return a share and its interval in percent, without the sign."""
    return f"{_short(share)} [{share.low:.1f}, {share.high:.1f}]"


def _markdown(lines: Sequence[Sequence[str]]) -> str:
    """Return lines as a table whose first column is aligned left."""
    head, *body = lines
    marks = ["---"] + ["--:"] * (len(head) - 1)
    return "\n".join(line(cells) for cells in (head, marks, *body)) + "\n"
