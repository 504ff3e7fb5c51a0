"""The tables of the leaderboard of all tracks, as Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from benchmark.report.board import paper_table
from benchmark.report.board.cells import RISK, Cell, cells, recall_at_risk
from benchmark.report.board.runs import BoardRun, TrackBoard
from benchmark.report.markdown import (
    BY_COURSE,
    INTEGRITY,
    INTEGRITY_COLUMNS,
    escape,
    line,
    nees_with_interval,
    number,
    paper_markdown,
    share_text,
)
from benchmark.report.tables import start_in_words
from benchmark.results.query_result import TOTAL
from benchmark.scoring.score import THRESHOLDS
from benchmark.scoring.summary import Percentage, Summary, summarize
from benchmark.submissions.submission import Card


@dataclass(frozen=True)
class HeadlineRow:
    """The metrics of a method on one group of queries (*cell*).

    Attributes:
        start: name of the starting information.
        season: condition of the queries, or a summary such as "changed", see ``Cell``.
        part: "all" or a part of the track.
        method: label of the method.
        cell_queries: number of queries of the cell; a method may lack results of some of them.
        places: number of places of the queries for which the method has results.
        surest: recall at 0.5 m 5° at bounded risk, see ``cells.recall_at_risk``; None if no answer
            has a probability or a sigma, or the reference poses are too inexact for 0.5 m.
        summary: figures of the queries.
    """

    start: str
    season: str
    part: str
    method: str
    cell_queries: int
    places: int
    surest: Percentage | None
    summary: Summary


def headline(board: TrackBoard) -> Iterator[HeadlineRow]:
    """Yield the figures of every start, cell and method of a track that has results."""
    for start in dict.fromkeys(run.start for run in board.runs):
        for cell in cells(board.queries):
            for run in board.runs:
                if run.start == start and run.has[cell.rows].any():
                    yield _row(board, cell, run)


def _row(board: TrackBoard, cell: Cell, run: BoardRun) -> HeadlineRow:
    rows = cell.rows[run.has[cell.rows]]
    answers = run.answers_at(rows)
    unjudged = run.unjudged(board.datasets_at(rows))
    is_judged = str(THRESHOLDS[1]) not in unjudged
    surest = recall_at_risk(answers, THRESHOLDS[1]) if is_judged else None
    return HeadlineRow(
        start=run.start,
        season=cell.season,
        part=cell.part,
        method=run.label,
        cell_queries=len(cell.rows),
        places=len(board.datasets_at(rows)),
        surest=None if surest is None else Percentage(**surest._asdict()),
        summary=summarize(answers, unjudged=unjudged),
    )


def board_markdown(boards: Sequence[TrackBoard], rows: Sequence[Sequence[HeadlineRow]]) -> str:
    """Return a table for each track and prior, with a row for each group of queries and method.

    Args:
        boards: the tracks.
        rows: the figures of each track.
    """
    lines = [
        "# Leaderboard",
        "",
        "Recall is the percentage of all listed queries whose pose is closer than both thresholds, "
        f"with its 95 % interval; {BY_COURSE} Failed queries and fallback poses count as not "
        f"found. {INTEGRITY} Surest: "
        "answers are sorted by predicted probability (without one: by sigma), and as many of the "
        f"first as possible are accepted, with fewer than {RISK:.0%} wrong at 0.5 m 5°; "
        "the column is the share of all queries that are accepted and right. Where a method has "
        "results of fewer queries than are listed (48 of 72), do not compare it with the others.",
    ]
    for board, figures in zip(boards, rows, strict=True):
        lines += ["", f"## {escape(board.track.name)}: {escape(board.track.title)}"]
        for start in dict.fromkeys(row.start for row in figures):
            lines += ["", f"### Start: {escape(start_in_words(start))}", ""]
            lines += _table([row for row in figures if row.start == start])
        if not figures:
            lines += ["", "Nothing is measured yet."]
        lines += ["", *map(_card_line, board.cards)]
        lines += ["", *(f"- Missing: {escape(sentence)}." for sentence in board.missing)]
    text = "\n".join(lines).rstrip() + "\n"
    return text + paper_markdown(
        paper_table.lines(boards), paper_table.note(), paper_table.columns()
    )


def _card_line(card: Card) -> str:
    """Return the description of a submission by its authors, one line."""
    sentences = [
        f"{card.method} (submitted by {card.authors}), start {card.start}: {card.description}",
        f"Trained on: {card.trained_on}",
        *([] if card.hardware is None else [f"Hardware: {card.hardware}"]),
        *([] if card.url is None else [card.url]),
    ]
    return f"- {escape('. '.join(sentences))}"


def _table(rows: Sequence[HeadlineRow]) -> Iterator[str]:
    recalls = [f"{threshold} (%)" for threshold in THRESHOLDS]
    header = ["season", "part", "method", "queries", "courses", "places", *recalls, "surest (%)"]
    header += [*INTEGRITY_COLUMNS, "NEES", "in the ellipsoid (%)", "median m", "s/query"]
    yield line(header)
    yield line(["---", "---", "---", *["--:"] * (len(header) - 3)])
    for row in rows:
        summary, uncertainty = row.summary, row.summary.uncertainty
        yield line(
            [
                escape(row.season),
                escape(row.part),
                escape(row.method),
                _format_count(summary.queries, row.cell_queries),
                str(summary.courses),
                str(row.places),
                *(share_text(summary.recall[threshold.key]) for threshold in THRESHOLDS),
                share_text(row.surest),
                *(share_text(share) for share in summary.integrity()),
                "–" if uncertainty is None else nees_with_interval(uncertainty),
                "–" if uncertainty is None else uncertainty.within_95.text(),
                number(summary.median_t_m),
                number(summary.seconds.per_query.get(TOTAL)),
            ]
        )


def _format_count(queries: int, listed: int) -> str:
    """Return the number of a method's queries, and of all listed queries if these are more.

    Methods that were run on different queries cannot be compared.
    """
    return str(queries) if queries == listed else f"{queries} of {listed}"
