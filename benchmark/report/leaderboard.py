"""The command ``leaderboard``, which compares results files in Markdown, LaTeX and HTML."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from benchmark.report.latex import latex
from benchmark.report.markdown import markdown, paper_markdown
from benchmark.report.page import page
from benchmark.report.paper import note, side_by_side
from benchmark.report.tables import groups, table
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.outputs import OutputFile, check_outputs

MARKS: Final = {
    "leaderboard.md": b"Recall is the percentage of all listed queries",
    "leaderboard.tex": b"% \\usepackage{booktabs} and \\usepackage{textcomp} in the preamble.",
    "leaderboard.html": b"<title>ObjConnect leaderboard</title>",
}
"""Bytes near the beginning of each file, by which an earlier file is recognized and replaced."""


def leaderboard(results: Sequence[Path], out: Path | None = None) -> str:
    """Compare results files.

    Args:
        results: results files, or folders of them.
        out: folder for ``leaderboard.md``, ``leaderboard.tex`` and ``leaderboard.html``; None
            writes no file.

    Returns:
        The Markdown text.

    Raises:
        InputError: there are no results, a file is not a results file or its summaries do not
            match its per-query results, two files of one run differ, a file of thumbnails
            (``album.h5``) or of basins of convergence (``*.basin.json``) beside it is damaged, or
            ``out`` cannot be written.
    """
    if out is not None:
        check_outputs(
            (OutputFile(out / name, mark) for name, mark in MARKS.items()), results, within=out
        )
    runs = groups(results)
    tables = [table(group) for group in runs]
    lines = side_by_side(runs)
    text = markdown(tables) + paper_markdown(lines, note())
    if out is not None:
        html = page(runs)
        texts = (text, latex(tables, lines, note()), html)
        for name, written in zip(MARKS, texts, strict=True):
            write_text(out / name, written)
    return text
