"""Table I of the object-connect paper, with the figures of this project for the same columns.

The figures of the paper are given as printed, for its own method and the others. They were not
measured by this project, and the paper does not say how its runs of the other methods were
configured.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from benchmark.datasets.cmu import TRACK as CMU
from benchmark.datasets.simulated import TRACK as SIMULATED
from benchmark.report.tables import Group, start_in_words
from benchmark.results.query_result import QueryResult
from benchmark.scoring.intervals import Interval
from benchmark.scoring.score import Threshold, recall

TITLE: Final = "Table I of the object-connect paper, beside ours"
REPORTED: Final = "as reported by the paper"
_THRESHOLD: Final = Threshold(0.5, 5)

# The data sets of each column, by their track and the beginning of their name.
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
class TableCell:
    """The recall at 0.5 m, 5° in percent.

    The paper states neither intervals nor numbers of queries; they are None in its cells. A cell of
    this project has no interval where all queries are of one flight path (course).
    """

    value: float
    low: float | None = None
    high: float | None = None
    queries: int | None = None

    def text(self) -> str:
        """Return the cell for a table of text."""
        if self.queries is None:
            return f"{self.value:.1f}"
        return f"{Interval(self.value, self.low, self.high).text()} of {self.queries}"


@dataclass(frozen=True)
class Line:
    """The figures of a method, one cell for each column; None where there is no figure."""

    method: str
    source: str
    reported: bool
    cells: tuple[TableCell | None, ...]


def columns() -> tuple[str, ...]:
    """Return the headings of the columns."""
    return tuple(_COLUMNS)


def note() -> str:
    """Return the note below the table: which of its figures may be compared."""
    return (
        f"Recall in % at {_THRESHOLD}. The upper lines are the paper's own figures for all of its "
        "methods; this project has not measured them. The lower lines pool all queries of the "
        "data sets given here. On CMU they count only the queries with public poses, a part of the "
        "queries of the paper. Our simulated flights differ from those of the paper, which are not "
        "public, so do not compare that column between the upper and the lower lines."
    )


def side_by_side(groups: Sequence[Group]) -> list[Line]:
    """Return the lines of the paper, then one for each of our methods and starts."""
    return paper_lines() + list(_project_lines(groups))


def paper_lines() -> list[Line]:
    """Return the lines of the paper."""
    return [
        Line(method, REPORTED, True, tuple(TableCell(value) for value in values))
        for method, values in _PAPER.items()
    ]


def _project_lines(groups: Sequence[Group]) -> Iterator[Line]:
    """Yield a line for each method and start, over all queries of a column's data sets."""
    by_run: dict[tuple[str, str], dict[str, list[QueryResult]]] = {}
    for group in groups:
        for column, (track, beginning) in _COLUMNS.items():
            if group.track == track and group.dataset.startswith(beginning):
                for run in group.runs:
                    source = source_text(group.start, run.results.method.is_external)
                    queries_by_column = by_run.setdefault((run.label, source), {})
                    queries_by_column.setdefault(column, []).extend(run.results.queries)
    for (method, source), queries_by_column in by_run.items():
        yield Line(
            method,
            source,
            False,
            tuple(
                pool(queries_by_column[column]) if column in queries_by_column else None
                for column in _COLUMNS
            ),
        )


def source_text(start: str, declared: bool = False) -> str:
    """Return the source of a line of this project.

    Args:
        start: name of the starting information.
        declared: whether the start is only what a user told the command ``score``; it is not
            verified.
    """
    return f"measured here, start{' as declared' if declared else ''}: {start_in_words(start)}"


def pool(queries: Sequence[QueryResult]) -> TableCell:
    """Return the cell of a column, over all queries of this project in it.

    Flights of the same name count as one course, because rendered sites with the same seed can have
    the same flight paths.
    """
    interval: Interval = recall(queries, _THRESHOLD)
    return TableCell(*interval, queries=len(queries))
