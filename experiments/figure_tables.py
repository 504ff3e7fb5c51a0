"""Tables of the stored results for the documents, as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.report.board.cells import conditions, parts
from benchmark.report.board.runs import BoardRun, TrackBoard
from benchmark.report.markdown import line
from benchmark.results.query_result import QueryResult
from benchmark.scoring.intervals import Interval
from benchmark.scoring.score import false_fixes, recall, worse_than_prior, wrong_answers
from benchmark.scoring.uncertainty import consistency
from benchmark.tracks.queries import SEEN, UNSEEN
from experiments.figure_values import (
    FOUND,
    look_up,
    percent,
    run_of,
    select,
    shared_queries,
    track_of,
)
from objconnect.scene.errors import InputError

Boards = Mapping[str, TrackBoard]

# The columns of the table of methods: each start, and the prior that it gives to a method.
_PRIORS: Final = {
    "error=3m,5deg": "prior off by 3 m, 5°",
    "gps=50m": "position off by 50 m, no attitude",
    "none": "no prior",
}
_TRACK: Final = "uav-seasons"

_Share = Callable[[Sequence[QueryResult]], Interval | None]
# The figures of integrity; all queries of a stored run have a prior, or none has.
_INTEGRITY: Final[Mapping[str, _Share]] = {
    "false fixes": false_fixes,
    "> 1 m": wrong_answers,
    "worse than prior": worse_than_prior,
}


def methods(boards: Boards) -> str:
    """Return the table of README: recall of all methods by the prior.

    Each column holds the changed queries of ``uav-seasons`` on the places that all methods with
    results from that start share. Stored results have no comparable seconds: they were timed on
    different days, while other programs ran.
    """
    board = track_of(boards, _TRACK)
    rows = {start: _shared(board, start) for start in _PRIORS}
    head = [f"{prior} ({_size(board, rows[start])})" for start, prior in _PRIORS.items()]
    lines = [["method", *head, *_INTEGRITY]]
    for method in board.track.methods:
        runs = {run.start: run for run in board.runs if run.method == method}
        answers = [runs[s].answers_at(rows[s]) if s in runs else None for s in _PRIORS]
        recalls = ["–" if a is None else recall(a, FOUND).text() for a in answers]
        counts = [
            ", ".join("–" if a is None else _count(share(a), a) for a in answers)
            for share in _INTEGRITY.values()
        ]
        lines.append([f"`{method}`", *recalls, *counts])
    return _markdown(lines)


def recall_by(boards: Boards, track: str, start: str, by: str, queries: str = "changed") -> str:
    """Return recall at 0.5 m and 5 degrees: a column for each method, intervals in the last row.

    Args:
        boards: tracks with their results.
        track: name of the track.
        start: name of the start.
        by: kind of the rows: ``part`` or ``condition``.
        queries: words that choose the queries, see ``figure_values.QUERIES_HELP``.

    Raises:
        InputError: a name is unknown.
    """
    board = track_of(boards, track)
    runs = _runs(board, start)
    lines = [["", *(f"`{run.method}`" for run in runs)]]
    for name in _row_names(board, by, queries):
        lines.append(_row(board, name, runs, select(board, f"{queries}+{name}"), _short))
    everything = select(board, queries)
    lines.append(_row(board, "all", runs, everything, Interval.text))
    lines += [
        [name, *(_count_with_share(share, run, everything) for run in runs)]
        for name, share in _INTEGRITY.items()
        if any(share(run.answers_at(everything)) for run in runs)
    ]
    return _markdown(lines)


def novelty(boards: Boards, track: str, start: str, *names: str) -> str:
    """Return recall at 0.5 m and 5 degrees on what training may use and on what a track holds out.

    It counts the changed queries that all methods in the table were given, so that columns can be
    compared.
    Each row states its places, queries and courses.

    Args:
        boards: tracks with their results.
        track: name of the track.
        start: name of the start.
        names: methods; if none is named, all with results from the start.

    Raises:
        InputError: a name is unknown, or the track holds out nothing.
    """
    board = track_of(boards, track)
    runs = [run_of(board, start, name) for name in names] or _runs(board, start)
    shared = shared_queries(*runs, rows=select(board, "changed"))
    lines = [["", *(f"`{run.method}`" for run in runs)]]
    for name in (SEEN, *UNSEEN):
        rows = shared[[board.queries[row].novelty == name for row in shared]]
        if len(rows):
            places = len(board.datasets_at(rows))
            size = f"{places} {'place' if places == 1 else 'places'}, {_size(board, rows)}"
            recalls = (recall(run.answers_at(rows), FOUND).text() for run in runs)
            lines.append([f"{name.replace('-', ' ')} ({size})", *recalls])
    if len(lines) == 1:
        raise InputError(f"{track} holds out nothing: its queries are neither seen nor unseen")
    return _markdown(lines)


def covariances(boards: Boards, track: str, method: str) -> str:
    """Return how a method's errors compare with its covariances, by condition and start.

    Cells hold the mean NEES and the percentage in the 95 % ellipsoid; those of all queries hold
    their intervals by course too, which few courses of a condition would leave meaningless.

    Raises:
        InputError: a name is unknown.
    """
    board = track_of(boards, track)
    runs = [run for run in board.runs if run.method == method]
    lines = [["", *(f"`{run.start}`" for run in runs)]]
    for name in ("all", *conditions(board.queries)):
        rows = select(board, name)
        text = _consistency_with_intervals if name == "all" else _consistency
        lines.append([name, *(text(run.answers_at(rows)) for run in runs)])
    return _markdown(lines)


TABLES: Final[Mapping[str, Callable[..., str]]] = {
    "methods": methods,
    "recall": recall_by,
    "novelty": novelty,
    "covariances": covariances,
}
"""Each table by the first word of its comment; the other words are its arguments."""


def table(boards: Boards, words: str) -> str:
    """Return the table of a comment such as ``recall uav-seasons none part``.

    Raises:
        InputError: a word is unknown, or there are too many or too few.
    """
    name, *arguments = words.split()
    make = look_up(TABLES, name, "table")
    try:
        return make(boards, *arguments)
    except TypeError as error:
        raise InputError(f"table {words!r}: {error}") from None


def _queries_of_any(runs: Sequence[BoardRun], rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the queries among ``rows`` that at least one method was given."""
    return rows[np.array([run.has[rows] for run in runs]).any(axis=0)]


def _shared(board: TrackBoard, start: str) -> NDArray[np.int64]:
    """Return the changed queries that all methods with results from a start were given."""
    return shared_queries(*_runs(board, start), rows=select(board, "changed"))


def _runs(board: TrackBoard, start: str) -> list[BoardRun]:
    found = [run for run in board.runs if run.start == start]
    if not found:
        raise InputError(f"{board.track.name} keeps no results from start {start!r}")
    return found


def _row_names(board: TrackBoard, by: str, queries: str) -> tuple[str, ...]:
    names = {
        "part": parts(board.queries),
        "condition": conditions([board.queries[row] for row in select(board, queries)]),
    }
    return look_up(names, by, "kind of row")


def _size(board: TrackBoard, rows: NDArray[np.int64]) -> str:
    """Return the numbers of queries and of their courses, such as ``1680, 14 courses``."""
    courses = len(np.unique(board.courses[rows]))
    return f"{len(rows)}, {courses} {'course' if courses == 1 else 'courses'}"


def _row(
    board: TrackBoard,
    name: str,
    runs: Sequence[BoardRun],
    rows: NDArray[np.int64],
    text: Callable[[Interval], str],
) -> list[str]:
    """Return a row of recalls, with the number of queries where a method was given fewer."""
    queries = _queries_of_any(runs, rows)
    cells = [f"{name} ({_size(board, queries)})"]
    for answers in (run.answers_at(rows) for run in runs):
        cell = text(recall(answers, FOUND)) if answers else "–"
        cells.append(cell if len(answers) in (0, len(queries)) else f"{cell} ({len(answers)})")
    return cells


def _count_with_share(share: _Share, run: BoardRun, rows: NDArray[np.int64]) -> str:
    answers = run.answers_at(rows)
    found = share(answers)
    return "–" if found is None else f"{_count(found, answers)} ({percent(found)})"


def _count(share: Interval | None, answers: Sequence[QueryResult]) -> str:
    """Return a share as a number of answers; a dash where it is unknown."""
    return "–" if share is None else str(round(share.value * len(answers) / 100))


def _consistency(answers: Sequence[QueryResult]) -> str:
    found = consistency(answers)
    return "–" if found is None else f"{found.mean:.2f}, {found.within_95.value:.1f}"


def _consistency_with_intervals(answers: Sequence[QueryResult]) -> str:
    found = consistency(answers)
    if found is None:
        return "–"
    ends = "–" if found.ends is None else f"{found.ends[0]:.2f}, {found.ends[1]:.2f}"
    return f"{found.mean:.2f} [{ends}], {found.within_95.text()}"


def _short(share: Interval) -> str:
    return f"{share.value:.1f}"


def _markdown(lines: Sequence[Sequence[str]]) -> str:
    """Return lines as a table whose first column is aligned left."""
    head, *body = lines
    marks = "|---" + "|--:" * (len(head) - 1) + "|"
    return "\n".join([line(head), marks, *map(line, body)]) + "\n"
