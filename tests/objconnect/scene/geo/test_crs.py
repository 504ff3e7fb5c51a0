"""Coordinate reference systems by EPSG code, against published coordinates."""

from __future__ import annotations

import sys

import numpy as np
import pyproj
import pytest

from objconnect.scene.errors import InputError
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geometry.geodesy import Geodetic


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
    with pytest.raises(InputError, match=r"EPSG:1 is not a coordinate reference system"):
        Projection("EPSG:1")


def test_what_is_no_position() -> None:
    with pytest.raises(InputError, match=r"is not a position in WGS 84 / UTM zone 32N"):
        Projection("EPSG:32632").to_geodetic(np.array([np.inf, 0.0, 0.0]))


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(InputError, match=r"needs pyproj, .*pip install 'objconnect\[geo\]'"):
        Projection("EPSG:32632")


# Vertical systems of surveys, by code. None of their grids is installed; for some PROJ has none.
VERTICAL = (
    5701, 5703, 5705, 5709, 5710, 5711, 5714, 5715, 5720, 5728, 5730, 5773, 5778, 5783, 5799, 5831,
    3855, 3900, 6357, 6360, 6647, 6695, 7837, 7839, 8228, 9130,
)  # fmt: skip
# One of each kind: with a grid, without, in depths, of the whole earth.
QUICK = (3855, 5703, 5711, 5715, 5728)


@pytest.mark.parametrize(
    "code",
    [
        code if code in QUICK else pytest.param(code, marks=pytest.mark.thorough)
        for code in VERTICAL
    ],
)
def test_heights_by_a_ballpark_are_refused(code: int) -> None:
    with pytest.raises(InputError, match=r"heights in .*(is not installed|ballpark|point down)"):
        Projection(f"EPSG:4326+{code}")
    alone = Projection(f"EPSG:4326+{code}", horizontal=True)
    assert np.allclose(alone.from_geodetic(Geodetic(47.0, 8.0, 5.0)), [8.0, 47.0, 5.0])


@pytest.mark.parametrize(
    "words",
    [
        "+proj=utm +zone=32 +ellps=bessel +type=crs",
        "+proj=utm +zone=32 +ellps=GRS80 +type=crs",
        'PROJCS["mine",GEOGCS["x",DATUM["x",SPHEROID["x",6378137,298.25]],PRIMEM["Greenwich",0],'
        'UNIT["degree",0.0174532925199433]],PROJECTION["Mercator_1SP"],UNIT["metre",1]]',
    ],
)
def test_places_by_a_ballpark_are_refused(words: str) -> None:
    with pytest.raises(InputError, match="only a ballpark conversion between .* and WGS 84") as e:
        Projection(words)
    assert "\n" not in str(e.value) and len(str(e.value)) < 300


@pytest.mark.parametrize(
    ("crs", "place", "metres"),
    [
        ("EPSG:26710", Geodetic(40.0, -123.0, 0.0), 7),
        ("EPSG:21037", Geodetic(-2.0, 38.0, 0.0), 6),
        ("EPSG:24547", Geodetic(4.0, 102.0, 0.0), 15),
        ("EPSG:32632", Geodetic(47.0, 8.0, 0.0), None),
        ("EPSG:2056", Geodetic(47.0, 8.0, 0.0), None),
        ("EPSG:26910", Geodetic(40.0, -123.0, 0.0), None),
    ],
)
def test_what_is_exact_to_many_metres_is_told(
    crs: str, place: Geodetic, metres: float | None
) -> None:
    doubt = Projection(crs).doubt_at(place)
    assert (f"accurate to {metres} m" in doubt) if metres else not doubt


def test_units_of_all_axes() -> None:
    assert Projection("EPSG:32632").is_metric and not Projection("EPSG:2263").is_metric
    assert not Projection("EPSG:4979").is_metric
    assert Projection("EPSG:4979").height_unit_m == 1.0
    assert Projection("EPSG:32632").height_unit_m is None


def test_units_of_heights(egm96: float) -> None:
    feet = pyproj.CRS("EPSG:5773").to_json_dict()
    unit = {"type": "LinearUnit", "name": "foot", "conversion_factor": 0.3048}
    feet["coordinate_system"]["axis"][0]["unit"] = unit
    del feet["id"]
    parts = [pyproj.CRS("EPSG:32632").to_json_dict(), feet]
    compound = {"type": "CompoundCRS", "name": "feet", "components": parts}
    words = str(pyproj.CRS.from_json_dict(compound).to_wkt())
    place = Geodetic(47.0, 9.0, 148.25)
    as_is, metric = Projection(words), Projection(words, metric_heights=True)
    assert as_is.from_geodetic(place)[2] == pytest.approx(100 / 0.3048)
    assert metric.from_geodetic(place)[2] == pytest.approx(148.25 - egm96)
    assert (as_is.is_metric, metric.is_metric) == (False, True)
    for projection in (as_is, metric):
        back = projection.to_geodetic(projection.from_geodetic(place))
        assert np.allclose(back, place, atol=1e-6)
    assert Projection("EPSG:32632+5773").from_geodetic(place)[2] == pytest.approx(100.0)
