"""The examples in the docstrings of the product run and print what they say."""

from __future__ import annotations

import ast
import doctest
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = (
    "scene",
    "dense",
    "simulate",
    "ingest",
    "baselines",
    "objconnect",
    "mapping",
    "benchmark",
)
# The only module that imports Blender, which is an optional dependency.
EXCLUDED = {"simulate.render.blender"}


def modules_with_examples() -> list[str]:
    """Names of the modules with at least one docstring that has an example."""
    names = []
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            if ">>>" not in text:
                continue
            docstrings = [
                ast.get_docstring(node) or ""
                for node in ast.walk(ast.parse(text))
                if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            ]
            parts = path.relative_to(ROOT).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            if any(">>>" in text for text in docstrings) and name not in EXCLUDED:
                names.append(name)
    return names


MODULES = modules_with_examples()


def test_the_vocabulary_has_examples() -> None:
    assert {
        "objconnect.scene.geometry.pose",
        "objconnect.scene.geometry.camera",
        "objconnect.scene.config",
    } <= set(MODULES)


@pytest.mark.parametrize("name", MODULES)
def test_examples_run(name: str) -> None:
    module = importlib.import_module(name)
    examples = [test for test in doctest.DocTestFinder().find(module) if test.examples]
    assert examples
    runner = doctest.DocTestRunner(optionflags=doctest.IGNORE_EXCEPTION_DETAIL)
    messages: list[str] = []
    for example in examples:
        runner.run(example, out=messages.append)
    assert not runner.summarize(verbose=False).failed, "".join(messages)
