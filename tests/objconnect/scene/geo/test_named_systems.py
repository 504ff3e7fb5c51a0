"""Systems as lines name them, and the unit of their heights."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from objconnect.scene.errors import InputError
from objconnect.scene.geo.named_systems import parse_system

US_FOOT = 1200 / 3937
LONGITUDE, LATITUDE, HEIGHT = -91.994, 46.8427, 160.0
STATE_PLANE = (
    "+proj=lcc +lat_1=47.03333333333333 +lat_2=48.63333333333333 +lat_0=46.5 +lon_0=-93.1 "
    "+x_0=800000.00001016 +y_0=99999.99998984 +datum=NAD83 +units=us-ft +no_defs"
)


@pytest.mark.parametrize(
    ("line", "system", "unit"),
    [
        ("EPSG:32615", "EPSG:32615", 1.0),
        ("'WGS84 UTM 15N'", "EPSG:32615", 1.0),
        ("wgs84 utm zone 15 n", "EPSG:32615", 1.0),
        ("WGS 84 / UTM zone 15N", "EPSG:32615", 1.0),
        ("EPSG:4326", "EPSG:4326", 1.0),
        ("EPSG:26849 +vunits=us-ft", "EPSG:26849", US_FOOT),
        ("EPSG:26849 +vunits=ft", "EPSG:26849", 0.3048),
        ("EPSG:26849 +vunits=m", "EPSG:26849", 1.0),
        ("EPSG:26849 +vto_meter=0.3048", "EPSG:26849", 0.3048),
        (f"{STATE_PLANE} +vunits=us-ft", STATE_PLANE, US_FOOT),
        ("EPSG:2256 +vunits=ft", "EPSG:2256", 0.3048),
    ],
)
def test_a_place_and_its_height(line: str, system: str, unit: float) -> None:
    there = pyproj.Transformer.from_crs("EPSG:4326", system, always_xy=True)
    x, y = there.transform(LONGITUDE, LATITUDE)
    place = parse_system(line, "f:1").to_geodetic(np.array([x, y, HEIGHT / unit]), "f:1")
    np.testing.assert_allclose(place[:2], [LATITUDE, LONGITUDE], atol=2e-8)
    assert place.altitude == pytest.approx(HEIGHT, abs=1e-3)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "EPSG:26849",
            "f:1: the unit of heights is unknown .*EPSG:26849 has eastings in US survey",
        ),
        ("EPSG:2256", "unit of heights is unknown .*in foot"),
        (STATE_PLANE, "unit of heights is unknown .*US survey foot"),
        ("EPSG:26849 +vunits=fathom", r"\+vunits=fathom is not a unit of length"),
        ("EPSG:26849 +vto_meter=0", r"\+vto_meter=0 is not a positive number"),
        ("EPSG:26849 +vunits=m +vto_meter=2", "contradict each other"),
        ("EPSG:7415 +vunits=ft", "has heights of its own|need the grid"),
        ("WGS84 UTM 61N", "UTM has no zone 61"),
        ("EPSG:1", "f:1: .*is not a coordinate reference system"),
    ],
)
def test_what_is_unknown_is_named(line: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_system(line, "f:1").to_geodetic(np.array([500000.0, 5200000.0, 100.0]), "f:1")
