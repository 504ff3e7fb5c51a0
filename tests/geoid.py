"""Install a geoid grid of constant height for tests."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

UNDULATION_M = 48.25


@contextmanager
def installed_geoid(folder: Path) -> Iterator[float]:
    """Give PROJ a grid of EGM96 that is 48.25 m everywhere, in its old format, for the block."""
    import pyproj

    rows, columns = 181, 361
    header = struct.pack(">4d2i", -90.0, -180.0, 1.0, 1.0, rows, columns)
    content = np.full(rows * columns, UNDULATION_M, ">f4").tobytes()
    grids = folder / "grids"
    grids.mkdir()
    (grids / "egm96_15.gtx").write_bytes(header + content)
    before = pyproj.datadir.get_data_dir()
    pyproj.datadir.append_data_dir(str(grids))
    try:
        yield UNDULATION_M
    finally:
        pyproj.datadir.set_data_dir(before)
