"""A table of true heights beside photographs that tell none, some, or all of theirs."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from benchmark.auditing.command import audit
from benchmark.auditing.findings import Finding, Verdict
from benchmark.auditing.positions import EAST_NORTH, HEIGHTS
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.storage.exif import Exif, write_jpeg

COUNT = 6


def findings(folder: Path, told: int, above: float = 0.0) -> dict[str, Finding]:
    """Audit a table of heights ``above`` the truth; ``told`` photographs have an altitude."""
    rng = np.random.default_rng(2)
    rows = ["name,lat,lon,alt"]
    (folder / "images").mkdir()
    for k in range(COUNT):
        name, place = f"{k}.jpg", (46.8426 + (k % 3) / 4000, -91.9944 + k / 6000)
        altitude = 198.6 if k < told else math.nan
        pixels = rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
        write_jpeg(folder / "images" / name, pixels, Exif(Geodetic(*place, altitude), None))
        rows.append(f"{name},{place[0]},{place[1]},{198.6 + above}")
    (folder / "t.csv").write_text("\n".join(rows))
    (found,) = audit(folder / "t.csv", folder / "images")
    return {finding.check: finding for finding in found.findings}


@pytest.mark.parametrize("told", [0, 2])
def test_heights_that_photographs_do_not_tell_are_unknown(
    tmp_path: Path, told: int, caplog: pytest.LogCaptureFixture
) -> None:
    found = findings(tmp_path, told)
    assert found[HEIGHTS].verdict is Verdict.UNKNOWN
    assert "GPSAltitude" in found[HEIGHTS].detail
    assert found[EAST_NORTH].verdict is Verdict.RIGHT
    assert all(finding.verdict is not Verdict.WRONG for finding in found.values())
    assert f"{told}.jpg and {COUNT - told - 1} more: GPSAltitude is missing" in caplog.text


@pytest.mark.parametrize("told", [4, COUNT])
def test_heights_that_enough_photographs_tell_are_judged(tmp_path: Path, told: int) -> None:
    (tmp_path / "right").mkdir()
    (tmp_path / "wrong").mkdir()
    assert findings(tmp_path / "right", told)[HEIGHTS].verdict is Verdict.RIGHT
    off = findings(tmp_path / "wrong", told, 47.0)[HEIGHTS]
    assert (off.verdict, off.fault) == (Verdict.WRONG, "height-datum")
