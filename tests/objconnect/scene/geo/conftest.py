"""A grid of a geoid for the tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.geoid import installed_geoid


@pytest.fixture
def egm96(tmp_path: Path) -> Iterator[float]:
    """Height of the geoid above the ellipsoid everywhere, metres."""
    with installed_geoid(tmp_path) as undulation_m:
        yield undulation_m
