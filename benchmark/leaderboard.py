"""``leaderboard``: results files compared, as Markdown, LaTeX and one HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmark.latex import latex
from benchmark.markdown import markdown, paper_markdown
from benchmark.page import page
from benchmark.paper import note, side_by_side
from benchmark.tables import groups, table
from scene.files import write_text


def leaderboard(results: Sequence[Path], out: Path | None = None) -> str:
    """Compare results files.

    Args:
        results: results files, or folders of them.
        out: where to write ``leaderboard.md``, ``leaderboard.tex`` and ``leaderboard.html``, or
            None.

    Returns:
        The Markdown text.

    Raises:
        InputError: no results, a file that is none or whose figures do not follow from its
            queries, two files of one run that differ, a damaged album or basin beside it, or
            ``out`` cannot be written.
    """
    found = groups(results)
    boards = [table(group) for group in found]
    lines = side_by_side(found)
    text = markdown(boards) + paper_markdown(lines, note())
    if out is not None:
        html = page(found)
        write_text(out / "leaderboard.md", text)
        write_text(out / "leaderboard.tex", latex(boards, lines, note()))
        write_text(out / "leaderboard.html", html)
    return text
