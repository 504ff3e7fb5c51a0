"""Whatever is longer or wider than the rule of the house says why, where it is defined."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.documents import ROOT
from tests.docs.measure_packages import LONG, LONGEST, PACKAGES, WIDE, lines_of, parameters_of

FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def list_unexplained(path: Path) -> Iterator[str]:
    text = path.read_text(encoding="utf-8")
    lines, tree = text.splitlines(), ast.parse(text)
    if len(lines) > LONGEST and f"over {LONGEST} lines because" not in (
        ast.get_docstring(tree) or ""
    ):
        yield f"{len(lines)} lines"
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        comment = lines[node.lineno - 2].strip()
        if parameters_of(node) > WIDE and not comment.startswith("# More than six parameters: "):
            yield f"{node.name} takes {parameters_of(node)} parameters"
        if lines_of(node) > LONG and not comment.startswith(f"# More than {LONG} lines: "):
            yield f"{node.name} has {lines_of(node)} lines"


@pytest.mark.parametrize("package", PACKAGES)
def test_what_is_long_or_wide_says_why(package: str) -> None:
    wrong = {
        path.relative_to(ROOT).as_posix(): found
        for path in FILES
        if path.relative_to(ROOT).parts[0] == package and (found := list(list_unexplained(path)))
    }
    assert not wrong


def test_the_rule_is_noticed(tmp_path: Path) -> None:
    wide = "def wide(a, b, c, d, e, f, *, g): ...\n"
    path = tmp_path / "module.py"
    path.write_text(wide)
    assert list(list_unexplained(path)) == ["wide takes 7 parameters"]
    path.write_text("# More than six parameters: each is an option.\n" + wide)
    assert not list(list_unexplained(path))
    path.write_text("def long():\n" + "    pass\n" * LONGEST)
    assert list(list_unexplained(path)) == ["401 lines", "long has 401 lines"]
