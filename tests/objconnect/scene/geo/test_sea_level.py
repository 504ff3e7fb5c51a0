"""Altitudes of photographs above sea level, with the geoid and without."""

from __future__ import annotations

from pathlib import Path

import pytest

from objconnect.scene.geo import sea_level
from objconnect.scene.geo.sea_level import convert_to_ellipsoid
from objconnect.scene.storage.exif import read_exif
from tests.objconnect.scene.quantities import raw_exif as raw


@pytest.mark.parametrize(
    ("reference", "given", "grid", "altitude", "doubted"),
    [
        (2, -30.0, None, 70.0, False),
        (2, None, -30.0, 70.0, False),
        (2, -31.0, -30.0, 69.0, False),
        (3, 40.0, None, -60.0, False),
        (2, None, None, 100.0, True),
        (0, -30.0, -30.0, 100.0, False),
        (1, -30.0, -30.0, -100.0, False),
    ],
)
def test_sea_level_becomes_the_ellipsoid(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    reference: int,
    given: float | None,
    grid: float | None,
    altitude: float,
    doubted: bool,
) -> None:
    monkeypatch.setattr(sea_level, "geoid_undulation", lambda place: grid)
    gps = {"GPSLatitude": raw.rational(46.8426), "GPSLatitudeRef": raw.text("N")}
    gps |= {"GPSLongitude": raw.rational(91.9944), "GPSLongitudeRef": raw.text("W")}
    gps |= {"GPSAltitude": raw.rational(100.0), "GPSAltitudeRef": raw.byte(reference)}
    raw.write(tmp_path / "a.jpg", (40, 30), raw.exif({}, gps))
    exif = convert_to_ellipsoid(read_exif(tmp_path / "a.jpg"), given)
    assert exif.position is not None and exif.position.altitude == pytest.approx(altitude)
    assert bool(exif.doubts) is doubted and exif.refers_to_sea_level is doubted
