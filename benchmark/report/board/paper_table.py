"""Table I of the object-connect paper beside our recall under changed seasons and light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from benchmark.report.board.cells import ALL, cells
from benchmark.report.board.runs import BoardRun, TrackBoard
from benchmark.report.paper import Line, TableCell, paper_lines, pool, source_text
from benchmark.tracks.queries import CHANGED

# The headings of the columns, in the paper's order, with our benchmark track and part of it.
_COLUMNS: Final = {
    "urban: CMU / street-seasons": ("street-seasons", "urban"),
    "suburban: CMU / street-seasons": ("street-seasons", "suburban"),
    "park: CMU / street-seasons": ("street-seasons", "park"),
    "simulated UAV / uav-seasons": ("uav-seasons", ALL),
}


def columns() -> tuple[str, ...]:
    """Return the headings: the data of the paper, then our track."""
    return tuple(_COLUMNS)


def note() -> str:
    """Return the note below the table: which of its figures may be compared."""
    return (
        "Recall in % at 0.5 m 5°. The upper lines are the paper's own figures on its own data; "
        "this project has not measured them. The lower lines are ours on simulated places of the "
        "same kind, under changed conditions. The data differ, so do not compare across the two "
        "halves."
    )


def lines(boards: Sequence[TrackBoard]) -> list[Line]:
    """Return the lines of the paper, then one for each of our methods and starts."""
    runs = dict.fromkeys(
        (run.start, run.method, run.declared)
        for board in boards
        for run in board.runs
        if run.authors is None
    )
    ours = (
        Line(
            method, source_text(start, declared), False, tuple(_table_cells(boards, start, method))
        )
        for start, method, declared in runs
    )
    return paper_lines() + list(ours)


def _table_cells(
    boards: Sequence[TrackBoard], start: str, method: str
) -> Iterator[TableCell | None]:
    for track, part in _COLUMNS.values():
        found = [
            _pool_changed(board, run, part)
            for board in boards
            for run in board.runs
            if (board.track.name, run.start, run.method) == (track, start, method)
        ]
        yield found[0] if found else None


def _pool_changed(board: TrackBoard, run: BoardRun, part: str) -> TableCell | None:
    """Return the recall of a run on the changed queries of a part; None without results."""
    for cell in cells(board.queries):
        if (cell.season, cell.part) == (CHANGED, part):
            answers = run.answers_at(cell.rows)
            return pool(answers) if answers else None
    return None
