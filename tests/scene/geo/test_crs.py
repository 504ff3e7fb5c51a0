"""Coordinate reference systems by EPSG code, against published coordinates."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from scene.errors import InputError
from scene.geo.crs import Projection
from scene.geometry.geodesy import Geodetic


def test_a_point_in_utm() -> None:
    """Longitude 9 is the central meridian of zone 32: 500 km east, 0.9996 of the meridian's arc."""
    at = Projection("EPSG:32632").from_geodetic(Geodetic(45.0, 9.0, 120.0))
    # Snyder (1987), arc of the meridian from the equator to 45 degrees: 4984944.378 m.
    assert np.allclose(at, [500_000, 0.9996 * 4_984_944.378, 120.0], atol=2e-3)


@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:2056", "EPSG:4326", "EPSG:25832"])
def test_there_and_back(crs: str) -> None:
    place = Geodetic(46.95, 7.44, 560.0)
    projection = Projection(crs)
    back = projection.to_geodetic(projection.from_geodetic(place))
    assert np.allclose(back, place, atol=3e-8)


def test_east_comes_first() -> None:
    """The authority of EPSG:4326 has latitude first."""
    at = Projection("EPSG:4326").from_geodetic(Geodetic(47.0, 8.0, 5.0))
    assert np.allclose(at, [8.0, 47.0, 5.0])


@pytest.mark.parametrize(
    ("crs", "longitude", "reached"),
    [
        ("EPSG:32632", 9, True),
        ("EPSG:32632", 13, True),  # just beyond its border
        ("EPSG:32632", 20, False),
        ("EPSG:32601", 8, False),
        ("EPSG:32601", 179.5, True),  # its zone begins at -180
        ("EPSG:4326", 8, True),
    ],
)
def test_systems_reach_their_zone(crs: str, longitude: float, reached: bool) -> None:
    assert Projection(crs).reaches(Geodetic(47.0, longitude, 0.0)) == reached
    assert not Projection("EPSG:32632").reaches(Geodetic(-40.0, 9.0, 0.0))


def test_what_is_no_system() -> None:
    with pytest.raises(InputError, match=r"EPSG:1 is no coordinate reference system"):
        Projection("EPSG:1")


def test_what_is_no_position() -> None:
    with pytest.raises(InputError, match=r"is no position in WGS 84 / UTM zone 32N"):
        Projection("EPSG:32632").to_geodetic(np.array([np.inf, 0.0, 0.0]))


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(InputError, match=r"needs pyproj, .*pip install 'objconnect\[geo\]'"):
        Projection("EPSG:32632")
