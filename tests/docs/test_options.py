"""Options are few and described, and every configuration has a name of its own."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Final

from tests.docs.documents import ROOT
from tests.docs.measure_house import PACKAGES

MOST_FIELDS: Final = 459
"""Fields of all configurations. A new one is worth it where somebody sets it; lower this number
with every one that goes."""


def _bases(node: ast.ClassDef) -> set[str]:
    return {base.id for base in node.bases if isinstance(base, ast.Name)}


@cache
def _configurations() -> tuple[ast.ClassDef, ...]:
    """Return the classes that derive from ``Config``, directly or through others."""
    files = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in files]
    classes = [n for tree in trees for n in ast.walk(tree) if isinstance(n, ast.ClassDef)]
    known, found = {"Config"}, list[ast.ClassDef]()
    while more := [c for c in classes if _bases(c) & known and c not in found]:
        found += more
        known |= {node.name for node in more}
    return tuple(found)


def _fields(node: ast.ClassDef) -> Iterator[tuple[str, Mapping[str | None, ast.expr]]]:
    """Yield the fields of a class: name, and what ``Field`` is told of it by keyword."""
    for item in node.body:
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
            told = item.value.keywords if isinstance(item.value, ast.Call) else []
            yield item.target.id, {word.arg: word.value for word in told}


def test_fields_are_few() -> None:
    counted = {node.name: len(list(_fields(node))) for node in _configurations()}
    assert len(counted) > 50
    most = sorted(counted, key=lambda name: -counted[name])[:5]
    assert sum(counted.values()) <= MOST_FIELDS, f"make constants of what nobody sets: {most}"


def test_every_field_is_described_where_it_is_defined() -> None:
    silent = [
        f"{node.name}.{name}"
        for node in _configurations()
        for name, told in _fields(node)
        if "description" not in told
    ]
    listed = [c.name for c in _configurations() if "Attributes:" in (ast.get_docstring(c) or "")]
    assert not silent + listed, "say it in Field(description=...) alone"


def test_every_configuration_has_a_name_of_its_own() -> None:
    twice = [
        name for name, count in Counter(c.name for c in _configurations()).items() if count > 1
    ]
    assert not twice
