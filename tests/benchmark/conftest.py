"""Fixtures of the benchmark's tests."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from objconnect.scene.colmap.sift import SiftExtractor
from objconnect.scene.maps.features import Features
from tests.benchmark.made_data import write_flight, write_scene


@pytest.fixture(scope="module")
def extracted_once() -> Iterator[None]:
    """SIFT features of a picture, which are the same in every test, are extracted once."""
    extract = SiftExtractor.__call__
    known: dict[tuple[str, bytes], Features] = {}

    def remembered(extractor: SiftExtractor, rgb: NDArray[np.uint8]) -> Features:
        key = (str(extractor._options.todict()), rgb.tobytes())
        if key not in known:
            known[key] = extract(extractor, rgb)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SiftExtractor, "__call__", remembered)
        yield


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
