"""The headline cells of all tracks as Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from benchmark.report.board import paper_table
from benchmark.report.board.cells import RISK, Cell, cells, recall_at_risk
from benchmark.report.board.runs import BoardRun, TrackBoard
from benchmark.report.markdown import escape, line, nees_text, number, paper_markdown, recall_text
from benchmark.report.tables import start_in_words
from benchmark.results.query_result import TOTAL
from benchmark.scoring.score import THRESHOLDS
from benchmark.scoring.summary import Recall, Summary, summarize


@dataclass(frozen=True)
class HeadlineRow:
    """The figures of a method in a cell.

    Attributes:
        start: name of the starting information.
        season: "changed", "same" or a condition.
        part: "all" or a part of the track.
        method: label of the method.
        cell_queries: queries of the cell, of which a method may have answered a part.
        half_width: half the width of the cell's 95 % interval at a recall of 90 %, points.
        surest: recall at 0.5 m 5° at bounded risk, see ``benchmark.report.board.cells``; None where
            the method predicts no sigma.
        summary: figures of the queries.
    """

    start: str
    season: str
    part: str
    method: str
    cell_queries: int
    half_width: float
    surest: Recall | None
    summary: Summary


def headline(board: TrackBoard) -> Iterator[HeadlineRow]:
    """Yield the figures of every start, cell and method of a track that has results."""
    for start in dict.fromkeys(run.start for run in board.runs):
        for cell in cells(board.queries):
            for run in board.runs:
                if run.start == start and run.has[cell.rows].any():
                    yield _row(cell, run)


def _row(cell: Cell, run: BoardRun) -> HeadlineRow:
    answers = run.of(cell.rows)
    surest = recall_at_risk(answers, THRESHOLDS[1])
    return HeadlineRow(
        start=run.start,
        season=cell.season,
        part=cell.part,
        method=run.label,
        cell_queries=len(cell.rows),
        half_width=cell.half_width,
        surest=None if surest is None else Recall(**surest._asdict()),
        summary=summarize(answers, 0.0, None),
    )


def board_markdown(boards: Sequence[TrackBoard], rows: Sequence[Sequence[HeadlineRow]]) -> str:
    """Return a table for each track and start, with a row for each cell and method.

    Args:
        boards: the tracks.
        rows: the figures of each of them.
    """
    lines = [
        "# Leaderboard",
        "",
        "Recall is the percentage of all listed queries whose pose is closer than both thresholds, "
        "with its Wilson 95 % interval; failed queries and fallback poses count as wrong. ± is "
        "half the width of that interval at a recall of 90 %. False fixes are poses that a method "
        "calls right and that are wrong by more than 5 m or 10°. The surest are the share of all "
        "queries that are believed and right at 0.5 m 5° when answers are believed in the order of "
        "their predicted probability, else of their sigma, as long as fewer than "
        f"{RISK:.0%} of those are wrong.",
    ]
    for board, figures in zip(boards, rows, strict=True):
        lines += ["", f"## {escape(board.track.name)}: {escape(board.track.title)}"]
        for start in dict.fromkeys(row.start for row in figures):
            lines += ["", f"### Start: {escape(start_in_words(start))}", ""]
            lines += _table([row for row in figures if row.start == start])
        if not figures:
            lines += ["", "Nothing is measured yet."]
        lines += ["", *(f"- Missing: {escape(sentence)}." for sentence in board.missing)]
    text = "\n".join(lines).rstrip() + "\n"
    return text + paper_markdown(
        paper_table.lines(boards), paper_table.note(), paper_table.columns()
    )


def _table(rows: Sequence[HeadlineRow]) -> Iterator[str]:
    recalls = [f"{threshold} (%)" for threshold in THRESHOLDS]
    header = ["season", "part", "method", "queries", "±", *recalls, "surest (%)"]
    header += ["false fixes (%)", "NEES", "median m", "s/query"]
    yield line(header)
    yield line(["---", "---", "---", *["--:"] * (len(header) - 3)])
    for row in rows:
        summary, consistent = row.summary, row.summary.uncertainty
        yield line(
            [
                escape(row.season),
                escape(row.part),
                escape(row.method),
                _count_asked(summary.queries, row.cell_queries),
                f"{row.half_width:.1f}",
                *(recall_text(summary.recall[threshold.key]) for threshold in THRESHOLDS),
                "–" if row.surest is None else recall_text(row.surest),
                "–" if summary.false_fixes is None else recall_text(summary.false_fixes),
                "–" if consistent is None else nees_text(consistent.nees_mean),
                number(summary.median_t_m),
                number(summary.seconds.per_query.get(TOTAL)),
            ]
        )


def _count_asked(asked: int, of: int) -> str:
    """Return how many queries of a cell a method was asked; a part of them is no equal footing."""
    return str(asked) if asked == of else f"{asked} of {of}"
