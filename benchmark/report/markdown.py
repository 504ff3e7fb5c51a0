"""Tables of results as Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Final

from benchmark.report.paper import TITLE, Line, columns
from benchmark.report.tables import Table, saturation
from benchmark.results.query_result import TOTAL
from benchmark.scoring.score import THRESHOLDS, WRONG_M
from benchmark.scoring.summary import Percentage, Uncertainty
from objconnect.scene.runtime.escaping import for_terminal

# Characters that Markdown takes for markup. An underscore within a word is not markup.
_MARKUP: Final = re.compile(r"[\\`*\[\]|~$]|(?<![^\W_])_|_(?![^\W_])")
# NEES above this is shown as '> 1000': the covariance is useless, and the exact value does not
# matter. ``shared.js`` has the same number.
_LARGEST_NEES: Final = 1000
BY_COURSE: Final = (
    "queries of one course, the path that was flown, fail together, so intervals treat courses, "
    "not queries, as independent. [–] says that all queries are of one course, so that the "
    "interval is unknown."
)
"""Explanation of the intervals in the tables."""
INTEGRITY: Final = (
    "False fixes are poses of status ok that are wrong by more than 5 m or 10°. Two further "
    f"columns count poses of status ok whose position is wrong by more than {WRONG_M:g} m, or "
    "farther off than the prior's position; – means that there is no such position, or that the "
    "reference poses are too inexact to judge the figure."
)
"""Explanation of the columns of ``INTEGRITY_COLUMNS``."""
INTEGRITY_COLUMNS: Final = ("false fixes (%)", f"> {WRONG_M:g} m (%)", "worse than prior (%)")
"""Headings of the figures of ``Summary.integrity``."""
_HTML: Final = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})


def escape(text: str) -> str:
    """Escape a name so that Markdown shows it literally on one line."""
    return _MARKUP.sub(r"\\\g<0>", for_terminal(text).translate(_HTML))


def markdown(tables: Sequence[Table]) -> str:
    """Return the leaderboard as Markdown."""
    lines = [
        "# Leaderboard",
        "",
        "Recall is the percentage of all listed queries whose pose is closer than both thresholds, "
        f"with its 95 % interval; {BY_COURSE} Failed queries and fallback poses count as not "
        f"found. {INTEGRITY} Medians are over the queries with a pose. Only rows of one table can "
        "be compared.",
    ]
    for table in tables:
        lines += ["", f"## {escape(table.track)}: {escape(table.dataset)}", ""]
        lines += [escape(table.facts()), "", *_table(table)]
        if note := saturation(table):
            lines += ["", note]
    return "\n".join(lines) + "\n"


def paper_markdown(lines: Sequence[Line], note: str, headings: Sequence[str] = columns()) -> str:
    """Return Table I of the object-connect paper with our results as Markdown."""
    header = ["method", "source", *headings]
    text = ["", f"## {TITLE}", "", note, "", line(header)]
    text.append(line(["---", "---", *["--:"] * (len(header) - 2)]))
    for row in lines:
        cells = ["–" if cell is None else cell.text() for cell in row.cells]
        text.append(line([escape(row.method), escape(row.source), *cells]))
    return "\n".join(text) + "\n"


def _table(table: Table) -> Iterator[str]:
    """Yield the lines of one table."""
    recalls = [f"{threshold} (%)" for threshold in THRESHOLDS]
    header = ["method", "condition", "queries", "courses", *recalls, "median m", "median °"]
    header += [*INTEGRITY_COLUMNS, "failed + fallback", "s/query"]
    yield line(header)
    yield line(["---", "---", *["--:"] * (len(header) - 2)])
    for row in table.rows:
        summary = row.summary
        yield line(
            [
                escape(row.method),
                escape(row.condition),
                str(summary.queries),
                str(summary.courses),
                *(share_text(summary.recall[threshold.key]) for threshold in THRESHOLDS),
                number(summary.median_t_m),
                number(summary.median_r_deg),
                *(share_text(share) for share in summary.integrity()),
                f"{summary.failed} + {summary.fallback}",
                number(summary.seconds.per_query.get(TOTAL)),
            ]
        )


def line(cells: Sequence[str]) -> str:
    """Return a row of a table."""
    return "| " + " | ".join(cells) + " |"


def share_text(share: Percentage | None) -> str:
    """Format a percentage with its interval; a dash where it is unknown."""
    return "–" if share is None else share.text()


def nees_with_interval(figures: Uncertainty) -> str:
    """Format a mean NEES with its interval by course, such as ``5.7 [5.3, 6.1]``."""
    low, high = figures.nees_low, figures.nees_high
    ends = "–" if low is None or high is None else f"{nees_text(low)}, {nees_text(high)}"
    return f"{nees_text(figures.nees_mean)} [{ends}]"


def nees_text(value: float) -> str:
    """Format a NEES; values above the limit are shown as '> 1000'."""
    return f"> {_LARGEST_NEES}" if value > _LARGEST_NEES else f"{value:.1f}"


def number(value: float | None) -> str:
    """Return a figure with three decimals; a dash where it is unknown."""
    return "–" if value is None else f"{value:.3f}"
