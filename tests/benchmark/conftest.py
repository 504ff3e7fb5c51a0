"""Fixtures of the benchmark's tests."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from tests.benchmark.made_data import write_flight, write_scene


@pytest.fixture(scope="session")
def flights() -> Path:
    """The folder of real flights."""
    folder = os.environ.get("OBJCONNECT_FLIGHTS")
    if not folder:
        pytest.skip("OBJCONNECT_FLIGHTS is not set to a folder of real flights")
    return Path(folder)


@pytest.fixture
def made_flight(tmp_path: Path) -> Path:
    """A small flight made on the spot."""
    return write_flight(tmp_path / "meadow")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A small scene made on the spot."""
    return write_scene(tmp_path / "hamlet")


@pytest.fixture(params=["made", "real"])
def flight(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A flight to break: one made on the spot, and a copy of a real one."""
    if request.param == "made":
        return write_flight(tmp_path / "meadow")
    source = request.getfixturevalue("flights") / "brighton_beach"
    copy = tmp_path / "brighton_beach"
    shutil.copytree(source, copy, ignore=shutil.ignore_patterns("photos"))
    for path in [copy, *copy.rglob("*")]:
        path.chmod(0o755 if path.is_dir() else 0o644)
    return copy
