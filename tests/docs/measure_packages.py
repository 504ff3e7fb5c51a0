"""Measure how long and how wide the product's code is.

``python -m tests.docs.measure_packages`` prints the table; with ``--write`` it also goes into
docs/packages.md.
"""

from __future__ import annotations

import argparse
import ast
from dataclasses import dataclass
from statistics import quantiles

from tests.docs.documents import ROOT

PACKAGES = (
    "objconnect/scene",
    "objconnect/ingestion",
    "objconnect/learning",
    "objconnect/localization",
    "objconnect/network",
    "objconnect/mapping",
    "simulate",
    "baselines",
    "benchmark",
)
LONGEST = 400  # lines of a module
LONG = 60  # lines of a function
WIDE = 6  # parameters of a signature, self and cls left out
_BEGIN = "<!-- figures: python -m tests.docs.measure_packages -->\n"
_END = "<!-- end -->"


@dataclass(frozen=True)
class Measured:
    """Sizes of the code of one or several packages.

    Attributes:
        files: lines of each module.
        functions: lines of each function and method, without decorators and docstring.
        parameters: how many parameters each of them takes.
    """

    files: tuple[int, ...]
    functions: tuple[int, ...]
    parameters: tuple[int, ...]

    def row(self, name: str) -> str:
        """Return a row of the table."""
        long = sum(lines > LONG for lines in self.functions)
        wide = sum(count > WIDE for count in self.parameters)
        total = len(self.functions)
        tenth = quantiles(self.files, n=10)[-1] if len(self.files) > 1 else self.files[0]
        return (
            f"| {name} | {len(self.files)} | {sum(self.files)} | {tenth:.0f} | {total} | "
            f"{long} ({long / total:.1%}) | {wide} ({wide / total:.1%}) |"
        )


def measure(*packages: str) -> Measured:
    """Measure the modules of packages; empty ``__init__`` modules count as files."""
    files, functions, parameters = [], [], []
    for path in sorted(path for package in packages for path in (ROOT / package).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        files.append(len(text.splitlines()))
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                functions.append(lines_of(node))
                parameters.append(parameters_of(node))
    return Measured(tuple(files), tuple(functions), tuple(parameters))


def lines_of(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return how many lines a function has, without its decorators and docstring."""
    return _extent(node) - _docstring(node)


def parameters_of(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return how many parameters a function takes besides self and cls."""
    parameters = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    return sum(part.arg not in ("self", "cls") for part in parameters)


def _extent(node: ast.stmt) -> int:
    """Return how many lines a statement has."""
    return (node.end_lineno or node.lineno) - node.lineno + 1


def _docstring(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return how many lines the docstring of a function has."""
    return _extent(node.body[0]) if ast.get_docstring(node) is not None else 0


def table() -> str:
    """Return the table of all packages and of their sum, as Markdown."""
    lines = [
        "| package | files | lines | lines per file (90 % quantile) | functions | "
        f"functions over {LONG} lines | functions over {WIDE} parameters |",
        "|---|--:|--:|--:|--:|--:|--:|",
        *(measure(package).row(f"`{package}/`") for package in PACKAGES),
        measure(*PACKAGES).row("**all**"),
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the table and, where asked to, write it into docs/packages.md."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write it into docs/packages.md, too")
    made = table()
    print(made, end="")
    if parser.parse_args().write:
        path = ROOT / "docs" / "packages.md"
        before, rest = path.read_text(encoding="utf-8").split(_BEGIN)
        after = rest.split(_END, 1)[1]
        path.write_text(before + _BEGIN + made + _END + after, encoding="utf-8")


if __name__ == "__main__":
    main()
