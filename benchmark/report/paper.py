"""Table I of the object-connect paper, and our own figures for the same columns.

The paper's figures stand here as it prints them, for every method, also for those that are not its
own. They were not measured by this project, and nobody can say from the paper alone how its runs
of the other methods were set up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from benchmark.datasets.cmu import TRACK as CMU
from benchmark.datasets.simulated import TRACK as SIMULATED
from benchmark.report.tables import Group, start_in_words
from benchmark.results import QueryResult
from benchmark.score import Interval, Threshold, recall

TITLE: Final = "Table I of the object-connect paper, beside ours"
REPORTED: Final = "as reported by the paper"
_THRESHOLD: Final = Threshold(0.5, 5)

# Data sets of ours that belong to a column, by track and beginning of the name.
_COLUMNS: Final = {
    "CMU urban": (CMU, "cmu-urban"),
    "CMU suburban": (CMU, "cmu-suburban"),
    "CMU park": (CMU, "cmu-park"),
    "simulated UAV": (SIMULATED, ""),
}
_PAPER: Final = {
    "D2-Net": (89.3, 75.1, 51.4, 90.5),
    "PixLoc": (90.4, 81.1, 62.5, 93.8),
    "object-connect": (91.1, 83.4, 65.6, 94.3),
}


@dataclass(frozen=True)
class Cell:
    """Recall in percent at 0.5 m, 5°; the paper states no intervals and no numbers of queries."""

    value: float
    low: float | None = None
    high: float | None = None
    queries: int | None = None

    def text(self) -> str:
        """For a table of text."""
        if self.low is None:
            return f"{self.value:.1f}"
        return f"{self.value:.1f} [{self.low:.1f}, {self.high:.1f}] of {self.queries}"


@dataclass(frozen=True)
class Line:
    """A method's figures; a cell is None where there is none."""

    method: str
    source: str
    reported: bool
    cells: tuple[Cell | None, ...]


def columns() -> tuple[str, ...]:
    """Headings of the cells of every line."""
    return tuple(_COLUMNS)


def note() -> str:
    """What a reader has to know before comparing."""
    return (
        f"Recall in % at {_THRESHOLD}. The upper lines stand as the paper reports them, for all of "
        "its methods; they are not measurements of this project. Ours pool all queries of the data "
        "sets given here. On CMU those are the queries whose poses are public, a part of the "
        "paper's. The simulated flights of the paper are not public: ours are other flights, and "
        "that column compares nothing across the two halves."
    )


def side_by_side(groups: Sequence[Group]) -> list[Line]:
    """The paper's lines, then one for each of our methods and starts."""
    reported = [
        Line(method, REPORTED, True, tuple(Cell(value) for value in values))
        for method, values in _PAPER.items()
    ]
    return reported + list(_ours(groups))


def _ours(groups: Sequence[Group]) -> Iterator[Line]:
    pooled: dict[tuple[str, str], dict[str, list[QueryResult]]] = {}
    for group in groups:
        for column, (track, beginning) in _COLUMNS.items():
            if group.track == track and group.dataset.startswith(beginning):
                for run in group.runs:
                    cells = pooled.setdefault((run.label, group.start), {})
                    cells.setdefault(column, []).extend(run.results.queries)
    for (method, start), cells in pooled.items():
        yield Line(
            method,
            f"measured here, start: {start_in_words(start)}",
            False,
            tuple(_cell(cells[column]) if column in cells else None for column in _COLUMNS),
        )


def _cell(queries: Sequence[QueryResult]) -> Cell:
    found: Interval = recall(queries, _THRESHOLD)
    return Cell(*found, queries=len(queries))
