"""Tables of results as LaTeX, written for the package ``booktabs``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from benchmark.report.markdown import BY_COURSE, INTEGRITY, INTEGRITY_COLUMNS
from benchmark.report.paper import TITLE, Line, TableCell, columns
from benchmark.report.tables import Table
from benchmark.results.query_result import TOTAL
from benchmark.scoring.score import THRESHOLDS
from benchmark.scoring.summary import Percentage
from objconnect.scene.runtime.escaping import for_terminal

_ESCAPED: Final = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "°": r"\textdegree{}",
        "–": "--",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
        **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    }
)


def latex(tables: Sequence[Table], lines: Sequence[Line], note: str) -> str:
    """Return the leaderboard, and the object-connect paper's table with our results, in LaTeX."""
    parts = [
        r"% \usepackage{booktabs} and \usepackage{textcomp} in the preamble.",
        "% Recall in % of all listed queries, with its 95 % interval as a subscript; " + BY_COURSE,
    ]
    for number, table in enumerate(tables, 1):
        parts += ["", *_float(_leaderboard_table(table), _caption(table), f"leaderboard-{number}")]
    parts += ["", *_float(_paper_table(lines), f"{TITLE}. {note}", "paper")]
    return "\n".join(parts) + "\n"


def escape(text: str) -> str:
    """Escape text so that LaTeX prints it literally."""
    return for_terminal(text.replace("\n", " ")).translate(_ESCAPED)


def _caption(table: Table) -> str:
    return (
        f"{table.track}: {table.dataset}. Recall in % with its 95 % interval as a subscript; "
        f"{BY_COURSE} Failed queries and fallback poses count as not found. {INTEGRITY} "
        f"{table.facts()}"
    )


def _float(body: Iterator[str], caption: str, label: str) -> Iterator[str]:
    yield r"\begin{table}"
    yield r"\centering"
    yield f"\\caption{{{escape(caption)}}}"
    yield f"\\label{{tab:{label}}}"
    yield from body
    yield r"\end{table}"


def _leaderboard_table(table: Table) -> Iterator[str]:
    header = ["method", "condition", "queries", "courses", *(str(t) for t in THRESHOLDS)]
    header += ["median m", "median °", *INTEGRITY_COLUMNS, "failed", "fallback", "s/query"]
    rows = []
    for row in table.rows:
        summary = row.summary
        recalls = (summary.recall[threshold.key] for threshold in THRESHOLDS)
        rows.append(
            [
                escape(row.method),
                escape(row.condition),
                str(summary.queries),
                str(summary.courses),
                *(_recall(recall) for recall in recalls),
                _number(summary.median_t_m),
                _number(summary.median_r_deg),
                *(_recall(share) for share in summary.integrity()),
                str(summary.failed),
                str(summary.fallback),
                _number(summary.seconds.per_query.get(TOTAL)),
            ]
        )
    yield from _tabular(header, rows, [row.method for row in table.rows])


def _paper_table(lines: Sequence[Line]) -> Iterator[str]:
    rows = [
        [escape(line.method), escape(line.source), *(_cell(cell) for cell in line.cells)]
        for line in lines
    ]
    sources = ["reported" if line.reported else "measured" for line in lines]
    yield from _tabular(["method", "source", *columns()], rows, sources)


def _tabular(
    header: Sequence[str], rows: Sequence[Sequence[str]], parts: Sequence[str]
) -> Iterator[str]:
    """Yield a tabular, with a rule between rows of different parts.

    ``parts`` names the part of the table that each row belongs to.
    """
    yield f"\\begin{{tabular}}{{ll{'r' * (len(header) - 2)}}}"
    yield r"\toprule"
    yield " & ".join(escape(cell) for cell in header) + r" \\"
    previous = None
    for row, part in zip(rows, parts, strict=True):
        if part != previous:
            yield r"\midrule"
        previous = part
        yield " & ".join(row) + r" \\"
    yield r"\bottomrule"
    yield r"\end{tabular}"


def _cell(cell: TableCell | None) -> str:
    if cell is None:
        return "--"
    if cell.queries is None:
        return f"{cell.value:.1f}"
    return _interval(cell.value, cell.low, cell.high)


def _recall(recall: Percentage | None) -> str:
    return "--" if recall is None else _interval(recall.value, recall.low, recall.high)


def _interval(value: float, low: float | None, high: float | None) -> str:
    ends = r"\mbox{--}" if low is None or high is None else f"{low:.1f},\\,{high:.1f}"
    return f"${value:.1f}_{{[{ends}]}}$"


def _number(value: float | None) -> str:
    return "--" if value is None else f"{value:.3f}"
