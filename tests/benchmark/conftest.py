"""Fixtures of the benchmark's tests."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.benchmark.made_data import write_flight, write_scene


@pytest.fixture
def made_flight(tmp_path: Path) -> Path:
    """A small flight made on the spot."""
    return write_flight(tmp_path / "meadow")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A small scene made on the spot."""
    return write_scene(tmp_path / "hamlet")


@pytest.fixture
def flight_copy(beach: Path, tmp_path: Path) -> Path:
    """A copy of a real flight to break."""
    copy = tmp_path / beach.name
    shutil.copytree(beach, copy, ignore=shutil.ignore_patterns("photos"))
    for path in [copy, *copy.rglob("*")]:
        path.chmod(0o755 if path.is_dir() else 0o644)
    return copy


@pytest.fixture(params=["made", "real"])
def flight(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A flight to break: one made on the spot, and a copy of a real one."""
    if request.param == "made":
        return write_flight(tmp_path / "meadow")
    copy: Path = request.getfixturevalue("flight_copy")
    return copy
