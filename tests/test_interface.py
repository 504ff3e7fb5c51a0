"""The Python interface: every name exists, type checkers see it, and importing is quick."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import benchmark
import objconnect
import simulate

PACKAGES = (objconnect, benchmark, simulate)
# What takes long to import.
HEAVY = {"torch", "cv2", "pycolmap", "matplotlib", "h5py", "skimage", "typer", "pydantic", "numpy"}


@pytest.mark.parametrize(
    ("package", "name"), [(p.__name__, name) for p in PACKAGES for name in p.__all__]
)
def test_every_name_is_there_and_documented(package: str, name: str) -> None:
    assert inspect.getdoc(getattr(import_module(package), name))


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_type_checkers_see_every_name(package: object) -> None:
    tree = ast.parse(Path(inspect.getfile(package)).read_text(encoding="utf-8"))  # type: ignore[arg-type]
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    seen = {
        alias.asname or alias.name
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    seen |= {
        target.id
        for node in block.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    assert seen == set(package.__all__) == set(dir(package))  # type: ignore[attr-defined]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_no_module_hides_a_name(package: object) -> None:
    """Python would put a module of the same name in the place of a call once it is imported."""
    folder = Path(inspect.getfile(package)).parent  # type: ignore[arg-type]
    modules = {path.stem for path in folder.iterdir() if path.suffix in ("", ".py")}
    assert not modules & set(package.__all__)  # type: ignore[attr-defined]


def test_another_name_is_an_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        objconnect.nothing  # noqa: B018


@pytest.mark.parametrize("package", [package.__name__ for package in PACKAGES])
def test_importing_it_is_quick(package: str) -> None:
    code = f"import sys, {package}; print(*{{m.split('.')[0] for m in sys.modules}})"
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert not HEAVY & set(answer.stdout.split())
