"""A grid of a geoid that tests may use."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyproj
import pytest


@pytest.fixture
def egm96(tmp_path: Path) -> Iterator[float]:
    """A grid of EGM96 that is 48.25 m everywhere, in the old format of PROJ."""
    rows, columns = 181, 361
    header = struct.pack(">4d2i", -90.0, -180.0, 1.0, 1.0, rows, columns)
    grids = tmp_path / "grids"
    grids.mkdir()
    (grids / "egm96_15.gtx").write_bytes(header + np.full(rows * columns, 48.25, ">f4").tobytes())
    before = pyproj.datadir.get_data_dir()
    pyproj.datadir.append_data_dir(str(grids))
    yield 48.25
    pyproj.datadir.set_data_dir(before)
