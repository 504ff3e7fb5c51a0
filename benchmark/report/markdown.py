"""Tables of results as Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Final

from benchmark.report.paper import TITLE, Line, columns
from benchmark.report.tables import Table, saturation
from benchmark.results import TOTAL, Recall
from benchmark.score import THRESHOLDS
from scene.runtime.escaping import for_terminal

# Characters that Markdown takes for markup. An underscore within a word is not markup.
_MARKUP: Final = re.compile(r"[\\`*\[\]|~$]|(?<![^\W_])_|_(?![^\W_])")
_HTML: Final = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})


def escaped(text: str) -> str:
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
        lines += ["", f"## {escaped(board.track)}: {escaped(board.dataset)}", ""]
        lines += [escaped(board.facts()), "", *_table(board)]
        if note := saturation(board):
            lines += ["", note]
    return "\n".join(lines) + "\n"


def paper_markdown(lines: Sequence[Line], note: str) -> str:
    """Return the paper's table with our figures as Markdown."""
    header = ["method", "source", *columns()]
    text = ["", f"## {TITLE}", "", note, "", _line(header)]
    text.append(_line(["---", "---", *["--:"] * (len(header) - 2)]))
    for line in lines:
        cells = ["–" if cell is None else cell.text() for cell in line.cells]
        text.append(_line([escaped(line.method), escaped(line.source), *cells]))
    return "\n".join(text) + "\n"


def _table(board: Table) -> Iterator[str]:
    """Yield the lines of one table."""
    recalls = [f"{threshold} (%)" for threshold in THRESHOLDS]
    header = ["method", "condition", "queries", *recalls, "median m", "median °"]
    header += ["false fixes (%)", "failed + fallback", "s/query"]
    yield _line(header)
    yield _line(["---", "---", *["--:"] * (len(header) - 2)])
    for row in board.rows:
        summary = row.summary
        yield _line(
            [
                escaped(row.method),
                escaped(row.condition),
                str(summary.queries),
                *(_recall(summary.recall[threshold.key]) for threshold in THRESHOLDS),
                _number(summary.median_t_m),
                _number(summary.median_r_deg),
                "–" if summary.false_fixes is None else _recall(summary.false_fixes),
                f"{summary.failed} + {summary.fallback}",
                _number(summary.seconds.per_query.get(TOTAL)),
            ]
        )


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _recall(recall: Recall) -> str:
    return f"{recall.value:.1f} [{recall.low:.1f}, {recall.high:.1f}]"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"
