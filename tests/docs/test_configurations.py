"""Options are few and described, and every configuration has a name of its own."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Final, NamedTuple

from tests.docs.documents import ROOT
from tests.docs.measure_house import PACKAGES

MOST_FIELDS: Final = 459
"""Fields of all configurations. A new one is worth it where somebody sets it; lower this number
with every one that goes."""

TO_DESCRIBE: Final = ("objconnect/localization/", "objconnect/network/", "baselines/pixloc/")
"""Rooms whose configurations are not yet described by ``Field`` alone."""


class _Configuration(NamedTuple):
    """A class that derives from ``Config``, directly or through others, and its file."""

    file: str
    node: ast.ClassDef

    def fields(self) -> Iterator[tuple[str, Mapping[str | None, ast.expr]]]:
        """Yield the fields of the class: name, and what ``Field`` is told of it by keyword."""
        for item in self.node.body:
            if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
                told = item.value.keywords if isinstance(item.value, ast.Call) else []
                yield item.target.id, {word.arg: word.value for word in told}


@cache
def _configurations() -> tuple[_Configuration, ...]:
    files = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    classes = [
        _Configuration(path.relative_to(ROOT).as_posix(), node)
        for path in files
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    ]
    known, found = {"Config"}, list[_Configuration]()
    while more := [c for c in classes if c not in found and _bases(c.node) & known]:
        found += more
        known |= {each.node.name for each in more}
    return tuple(found)


def _bases(node: ast.ClassDef) -> set[str]:
    return {base.id for base in node.bases if isinstance(base, ast.Name)}


def test_fields_are_few() -> None:
    counted = {each.node.name: len(list(each.fields())) for each in _configurations()}
    most = sorted(counted, key=lambda name: -counted[name])[:5]
    assert 200 < sum(counted.values()) <= MOST_FIELDS, f"constants of what nobody sets: {most}"


def test_every_field_is_described_where_it_is_defined() -> None:
    described = [each for each in _configurations() if not each.file.startswith(TO_DESCRIBE)]
    silent = [
        f"{each.node.name}.{name}"
        for each in described
        for name, told in each.fields()
        if "description" not in told
    ]
    listed = [c.node.name for c in described if "Attributes:" in (ast.get_docstring(c.node) or "")]
    assert not silent + listed, "say it in Field(description=...) alone"


def test_every_configuration_has_a_name_of_its_own() -> None:
    names = Counter(each.node.name for each in _configurations() if each.node.name[0] != "_")
    assert not [name for name, count in names.items() if count > 1]
