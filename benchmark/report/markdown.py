"""Tables of results as Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Final

from benchmark.report.paper import TITLE, Line, columns
from benchmark.report.tables import Table, saturation
from benchmark.results.query_result import TOTAL
from benchmark.scoring.score import THRESHOLDS
from benchmark.scoring.summary import Recall
from objconnect.scene.runtime.escaping import for_terminal

# Characters that Markdown takes for markup. An underscore within a word is not markup.
_MARKUP: Final = re.compile(r"[\\`*\[\]|~$]|(?<![^\W_])_|_(?![^\W_])")
# NEES above this is shown as '> 1000': the covariance is useless, and the exact value does not
# matter. ``shared.js`` has the same number.
_LARGEST_NEES: Final = 1000
_HTML: Final = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})


def escape(text: str) -> str:
    """Escape a name so that Markdown shows it literally on one line."""
    return _MARKUP.sub(r"\\\g<0>", for_terminal(text).translate(_HTML))


def markdown(boards: Sequence[Table]) -> str:
    """Return the leaderboard as Markdown."""
    lines = [
        "# Leaderboard",
        "",
        "Recall is the percentage of all listed queries whose pose is closer than both thresholds, "
        "with its Wilson 95 % interval; failed queries and fallback poses count as wrong. False "
        "fixes are poses that a method calls right and that are wrong by more than 5 m or 10°. "
        "Medians are over the queries with a pose. Only rows of one table can be compared.",
    ]
    for board in boards:
        lines += ["", f"## {escape(board.track)}: {escape(board.dataset)}", ""]
        lines += [escape(board.facts()), "", *_table(board)]
        if note := saturation(board):
            lines += ["", note]
    return "\n".join(lines) + "\n"


def paper_markdown(lines: Sequence[Line], note: str, headings: Sequence[str] = columns()) -> str:
    """Return the paper's table with our figures as Markdown."""
    header = ["method", "source", *headings]
    text = ["", f"## {TITLE}", "", note, "", line(header)]
    text.append(line(["---", "---", *["--:"] * (len(header) - 2)]))
    for row in lines:
        cells = ["–" if cell is None else cell.text() for cell in row.cells]
        text.append(line([escape(row.method), escape(row.source), *cells]))
    return "\n".join(text) + "\n"


def _table(board: Table) -> Iterator[str]:
    """Yield the lines of one table."""
    recalls = [f"{threshold} (%)" for threshold in THRESHOLDS]
    header = ["method", "condition", "queries", *recalls, "median m", "median °"]
    header += ["false fixes (%)", "failed + fallback", "s/query"]
    yield line(header)
    yield line(["---", "---", *["--:"] * (len(header) - 2)])
    for row in board.rows:
        summary = row.summary
        yield line(
            [
                escape(row.method),
                escape(row.condition),
                str(summary.queries),
                *(recall_text(summary.recall[threshold.key]) for threshold in THRESHOLDS),
                number(summary.median_t_m),
                number(summary.median_r_deg),
                "–" if summary.false_fixes is None else recall_text(summary.false_fixes),
                f"{summary.failed} + {summary.fallback}",
                number(summary.seconds.per_query.get(TOTAL)),
            ]
        )


def line(cells: Sequence[str]) -> str:
    """Return a row of a table."""
    return "| " + " | ".join(cells) + " |"


def nees_text(value: float) -> str:
    """Format a NEES; values above the limit are shown as '> 1000'."""
    return f"> {_LARGEST_NEES}" if value > _LARGEST_NEES else f"{value:.1f}"


def recall_text(recall: Recall) -> str:
    """Return a percentage with its interval."""
    return f"{recall.value:.1f} [{recall.low:.1f}, {recall.high:.1f}]"


def number(value: float | None) -> str:
    """Return a figure with three decimals; a dash where it is unknown."""
    return "–" if value is None else f"{value:.3f}"
