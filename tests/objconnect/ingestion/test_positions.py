from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from objconnect.ingestion.photographs import Flight, FlightImage, read_flight
from objconnect.ingestion.positions import local_positions, replace_positions
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import read_gps
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.storage.exif import Exif


@pytest.fixture(scope="module")
def flight(photographs: Path) -> Flight:
    return read_flight(photographs)


def test_a_table_takes_the_place_of_exif(flight: Flight, beach: Path, tmp_path: Path) -> None:
    """The flight's own, which has more columns; its metres have another origin."""
    placed = replace_positions(flight, beach / "gps.csv")
    ours, theirs = local_positions(placed.images)[1], read_gps(beach / "gps.csv")
    first = placed.images[0]
    for image in placed.images:
        step = ours[image.name] - ours[first.name]
        assert step == pytest.approx(theirs[image.file] - theirs[first.file], abs=0.02)
    table = tmp_path / "gps.csv"
    table.write_text("\ufeffname,lat,lon,alt\nDJI_0020.jpg,46.5,-92,200.5\nother.jpg,1,2,3\n")
    known = [image for image in replace_positions(flight, table).images if image.exif.position]
    assert [image.file for image in known] == ["DJI_0020.jpg"]
    assert known[0].exif.position == (46.5, -92, 200.5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "has no column name"),
        ("name;lat;lon;alt\nDJI_0020.jpg;1;2;3\n", "other separators than commas"),
        ("name,lat,lon\nDJI_0020.jpg,1,2\n", "has no column alt: its first line must name"),
        ("name,lat,lon,alt\nDJI_0020.jpg,1,2,\n", "line 2: lat, lon and alt must be"),
        ("name,lat,lon,alt\nDJI_0020.jpg,91,2,3\n", "line 2: lat, lon and alt must be"),
        ("name,lat,lon,alt\nDJI_0020.jpg,1,2,nan\n", "line 2: lat, lon and alt must be"),
        ("name,lat,lon,alt\nDJI_0020.jpg,1,2\n", "line 2: lat, lon and alt must be"),
        ("name,lat,lon,alt\nb.jpg,1,2,3\nb.jpg,1,2,4\n", "line 3: b.jpg is listed twice"),
        ("name,lat,lon,alt\nb.jpg,1,2,3\n", "names none of the photographs: its first name is 'b"),
    ],
)
def test_tables_that_are_wrong(flight: Flight, tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "gps.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        replace_positions(flight, tmp_path / "gps.csv")
    with pytest.raises(InputError, match="cannot read table of positions"):
        replace_positions(flight, tmp_path / "missing.csv")


def test_a_receiver_that_is_stuck(flight: Flight, tmp_path: Path) -> None:
    names = [image.file for image in flight.images]
    stuck = len(names) // 2 + 1
    rows = [f"{name},46.5,{-92 + max(0, k - stuck + 1) / 1000},200" for k, name in enumerate(names)]
    (tmp_path / "gps.csv").write_text("\n".join(["name, lat, lon, alt", *rows]))
    with pytest.raises(InputError, match=f"{stuck} of {len(names)} GPS positions are equal"):
        local_positions(replace_positions(flight, tmp_path / "gps.csv").images)


def place_at(*altitudes: float) -> list[FlightImage]:
    """Photographs on a line to the north, 11 m apart."""
    return [
        FlightImage(
            f"{k}.jpg",
            f"flight/images/{k}.jpg",
            str(k),
            Exif(Geodetic(46.8 + k / 1e4, -92.0, altitude), None),
            (4000, 3000),
        )
        for k, altitude in enumerate(altitudes)
    ]


def test_unknown_altitudes_take_no_part(caplog: pytest.LogCaptureFixture) -> None:
    origin, fixes = local_positions(place_at(198.0, math.nan, 199.0, math.nan, 200.0))
    assert origin == pytest.approx((46.8002, -92.0, 199.0))
    up = [fix[2] for fix in fixes.values()]
    assert up == pytest.approx([-1, math.nan, 0, math.nan, 1], abs=1e-3, nan_ok=True)
    north = [fix[1] for fix in fixes.values()]
    assert np.diff(north) == pytest.approx([11.12] * 4, abs=0.01)
    assert "3 of 5 photographs with a GPS position have an altitude (GPSAltitude)" in caplog.text


def test_no_altitude_at_all_is_no_origin() -> None:
    blind = place_at(*[math.nan] * 4)
    with pytest.raises(InputError, match=r"none of 4 photographs .* \(GPSAltitude\).*--gps"):
        local_positions(blind)
    # A world that is known needs none.
    origin = Geodetic(46.8, -92.0, 150.0)
    assert np.isnan([fix[2] for fix in local_positions(blind, origin)[1].values()]).all()
