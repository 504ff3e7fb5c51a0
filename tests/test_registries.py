"""Registries: entries load, the documentation lists their names, and listing imports little."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmark.cli.choices import describe_choices, list_choices
from benchmark.datasets.open import READERS, Reader
from objconnect.methods import LOCALIZERS, TRAINABLES
from objconnect.scene.exports.formats import FORMATS
from objconnect.scene.imports.formats import FORMATS as POSE_FORMATS
from objconnect.scene.registry import Lazy, Registry
from simulate.look.conditions import LIGHTS, WEATHER
from simulate.look.seasons import SEASONS
from simulate.place.presets import PRESETS
from tests.test_imports import ALLOWED

ROOT = Path(__file__).parents[1]
REGISTRIES: dict[str, Registry[Any]] = {
    "objconnect.methods.LOCALIZERS": LOCALIZERS,
    "objconnect.methods.TRAINABLES": TRAINABLES,
    "benchmark.datasets.open.READERS": READERS,
    "objconnect.scene.exports.formats.FORMATS": FORMATS,
    "objconnect.scene.imports.formats.FORMATS": POSE_FORMATS,
    "simulate.place.presets.PRESETS": PRESETS,
    "simulate.look.seasons.SEASONS": SEASONS,
    "simulate.look.conditions.LIGHTS": LIGHTS,
    "simulate.look.conditions.WEATHER": WEATHER,
}
# First heading of the documentation's table of each registry.
TABLES: dict[str, Registry[Any]] = {
    "method": LOCALIZERS,
    "format": FORMATS,
    "format of poses": POSE_FORMATS,
    "data set": READERS,
    "preset": PRESETS,
}
# Rows of one table; the names stand in the second cell.
ROWS: dict[str, Registry[Any]] = {"season": SEASONS, "light": LIGHTS, "weather": WEATHER}


def documentation_lines() -> list[str]:
    """The lines of every page."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [line for page in pages for line in [*page.read_text("utf-8").splitlines(), ""]]


def documentation_tables() -> list[list[list[str]]]:
    """Every table of the documentation as rows of cells, the headings first."""
    found: list[list[list[str]]] = [[]]
    for line in documentation_lines():
        if not line.startswith("|"):
            found.append([])
        elif not re.fullmatch(r"[|\s:-]+", line) or not found[-1]:
            found[-1].append([cell.strip() for cell in line.strip("|").split("|")])
    return [table for table in found if table]


@pytest.mark.parametrize("heading", TABLES)
def test_a_table_of_the_documentation_lists_the_names(heading: str) -> None:
    columns = [
        [row[0] for row in table[1:]] for table in documentation_tables() if table[0][0] == heading
    ]
    assert [f"`{name}`" for name in TABLES[heading].built_in] in columns


@pytest.mark.parametrize("part", ROWS)
def test_a_row_of_the_documentation_lists_the_parts_of_conditions(part: str) -> None:
    rows = [
        row for table in documentation_tables() for row in table if row[0] == part and len(row) > 1
    ]
    assert list(ROWS[part].built_in) in [re.findall("`(.+?)`", row[1]) for row in rows]


@pytest.mark.parametrize("path", REGISTRIES)
def test_every_built_in_entry_loads(path: str) -> None:
    registry = REGISTRIES[path]
    for name in registry.built_in:
        assert registry.accepts(registry.load(name)), name


@pytest.mark.parametrize("path", REGISTRIES)
def test_entries_follow_the_import_arrows(path: str) -> None:
    """Names of modules in strings are imports, too; the list of methods alone names those of
    ``baselines``, which are imported when they are created."""
    package = "benchmark" if path.startswith("objconnect.methods.") else path.split(".")[0]
    targets = [e.target for e in REGISTRIES[path].built_in.values() if isinstance(e, Lazy)]
    assert {target.split(".")[0] for target in targets} <= ALLOWED[package] | {package}


def test_readers_are_known_by_their_names() -> None:
    assert [reader.name for reader in READERS.values()] == list(READERS)
    assert all(isinstance(reader, Reader) for reader in READERS.values())


def test_help_explains_every_format() -> None:
    assert set(FORMATS.summaries()) == set(FORMATS.built_in)
    assert list_choices(FORMATS).startswith(
        "<colmap|colmap-database|nerfstudio|nerfstudio-depth|tum|hloc"
    )
    assert "tum: a trajectory per session." in describe_choices(FORMATS)


def list_loaded_by(code: str) -> set[str]:
    """Top-level modules in memory after running code in a process of its own."""
    lines = f"{code}\nimport sys\nprint(*{{m.split('.')[0] for m in sys.modules}})"
    answer = subprocess.run(
        [sys.executable, "-c", lines], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return set(answer.stdout.split())


def test_listing_names_loads_nothing_heavy() -> None:
    loaded = list_loaded_by("import benchmark.cli")
    assert "benchmark" in loaded
    assert not {"numpy", "torch", "pydantic", "pycolmap", "bpy"} & loaded


def test_opening_does_not_load_colmap() -> None:
    """Neither the readers of data sets nor the formats that need no COLMAP do, nor the method.

    COLMAP takes 60 MB, and a query with a prior needs nothing of it.
    """
    code = """
from pathlib import Path
from benchmark.datasets.open import READERS, open_datasets
from objconnect.methods import create
from objconnect.scene.exports.export import export
from objconnect.scene.exports.formats import FORMATS
list(READERS.values())
open_datasets(Path("benchmark/gate/gate"))
[FORMATS.load(name) for name in ("nerfstudio", "tum", "hloc")]
create("objconnect", {})
"""
    loaded = list_loaded_by(code)
    assert "objconnect" in loaded
    assert "pycolmap" not in loaded
