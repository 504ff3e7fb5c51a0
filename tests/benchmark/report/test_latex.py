from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmark.report.latex import escape, latex
from benchmark.report.paper import note, side_by_side
from benchmark.report.tables import groups, table
from tests.benchmark.report.test_leaderboard import run


@pytest.fixture
def text(scene: Path, tmp_path: Path) -> str:
    files = [run(scene, tmp_path / "1", "my_method"), run(scene, tmp_path / "2", "50%&#{$}")]
    found = groups(files)
    return latex([table(group) for group in found], side_by_side(found), note())


def test_text_is_escaped_for_latex() -> None:
    assert escape(r"a_b & 50% of #1 {x} $y$ C:\z ~^") == (
        r"a\_b \& 50\% of \#1 \{x\} \$y\$ C:\textbackslash{}z \textasciitilde{}\textasciicircum{}"
    )
    assert escape("two\nlines <b> | °–") == (
        r"two lines \textless{}b\textgreater{} \textbar{} \textdegree{}--"
    )


def test_the_table_is_well_formed_latex(text: str) -> None:
    for name in ("table", "tabular"):
        begun, ended = (text.count(f"\\{word}{{{name}}}") for word in ("begin", "end"))
        assert begun == ended == 2
    assert text.count(r"\toprule") == text.count(r"\bottomrule") == 2
    for body in re.findall(r"\\begin\{tabular\}\{(.*?)\}\n(.*?)\\end", text, re.DOTALL):
        columns, lines = len(body[0]), body[1].splitlines()
        rows = [line for line in lines if line.endswith(r"\\")]
        assert len(rows) >= 4
        for row in rows:
            assert len(re.findall(r"(?<!\\)&", row)) == columns - 1
    # Braces balance outside of escapes, or LaTeX runs away with the rest of the document.
    plain = re.sub(r"\\[{}]", "", text)
    assert plain.count("{") == plain.count("}")
    assert not re.findall(r"(?<!\\)%", "\n".join(text.splitlines()[2:]))


def test_the_table_states_the_figures_of_the_results(text: str) -> None:
    assert r"my\_method & summer-noon & 3 & 1 & $100.0_{[\mbox{--}]}$" in text
    assert r"50\%\&\#\{\$\}" in text
    assert r"PixLoc & as reported by the paper & 90.4 & 81.1 & 62.5 & 93.8 \\" in text
