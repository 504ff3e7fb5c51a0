from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from objconnect.scene.geometry.geodesy import (
    Geodetic,
    enu_from_geodetic,
    geodetic_from_enu,
    geodetics_from_enu,
)

latitudes = st.floats(-89.9, 89.9)
longitudes = st.floats(-180, 180)
altitudes = st.floats(-400, 9000)
places = st.builds(Geodetic, latitudes, longitudes, altitudes)
offsets = st.tuples(*[st.floats(-5000, 5000)] * 3)


@given(places, offsets)
def test_local_metres_come_back(origin: Geodetic, offset: tuple[float, float, float]) -> None:
    enu = np.array(offset)
    again = enu_from_geodetic(geodetic_from_enu(enu, origin), origin)
    np.testing.assert_allclose(again, enu, atol=1e-6)


@given(places, places)
def test_any_place_on_earth_comes_back(place: Geodetic, origin: Geodetic) -> None:
    again = geodetic_from_enu(enu_from_geodetic(place, origin), origin)
    turn = (again.longitude - place.longitude + 180) % 360 - 180
    assert again.latitude == pytest.approx(place.latitude, abs=1e-9)
    assert turn * math.cos(math.radians(place.latitude)) == pytest.approx(0, abs=1e-9)
    assert again.altitude == pytest.approx(place.altitude, abs=1e-5)


@given(places, st.lists(offsets, min_size=1, max_size=5))
def test_many_positions_are_converted_as_each_alone(
    origin: Geodetic, positions: list[tuple[float, float, float]]
) -> None:
    enu = np.array(positions)
    alone = [geodetic_from_enu(each, origin) for each in enu]
    np.testing.assert_allclose(geodetics_from_enu(enu, origin), alone, rtol=1e-12, atol=1e-7)


@pytest.mark.parametrize("latitude", [90.0, -90.0])
def test_the_poles(latitude: float) -> None:
    origin = Geodetic(latitude, 0.0, 0.0)
    place = geodetic_from_enu(np.array([0.0, 0.0, 120.0]), origin)
    assert place.latitude == pytest.approx(latitude)
    assert place.altitude == pytest.approx(120)


def test_the_origin_is_zero() -> None:
    origin = Geodetic(46.8, -92.0, 198.0)
    np.testing.assert_allclose(enu_from_geodetic(origin, origin), 0, atol=1e-9)


def test_lengths_of_a_degree_on_the_ellipsoid() -> None:
    """Published WGS84 lengths, scaled from a small arc, where chord and arc agree."""

    def per_degree(place: Geodetic, origin: Geodetic) -> float:
        return float(np.linalg.norm(enu_from_geodetic(place, origin))) * 1000

    assert per_degree(Geodetic(0.001, 0, 0), Geodetic(0, 0, 0)) == pytest.approx(110_574, abs=1)
    assert per_degree(Geodetic(0, 0.001, 0), Geodetic(0, 0, 0)) == pytest.approx(111_320, abs=1)
    assert per_degree(Geodetic(60.0005, 0, 0), Geodetic(59.9995, 0, 0)) == pytest.approx(
        111_412, abs=1
    )
    assert per_degree(Geodetic(60, 0.001, 0), Geodetic(60, 0, 0)) == pytest.approx(55_800, abs=1)


def test_one_degree_of_latitude_at_the_equator() -> None:
    north = enu_from_geodetic(Geodetic(1, 0, 0), Geodetic(0, 0, 0))
    assert np.linalg.norm(north) == pytest.approx(110_574, abs=3)


@pytest.mark.parametrize("latitude", [-60.0, -10.0, 0.0, 45.0])
def test_longitude_shrinks_with_latitude(latitude: float) -> None:
    origin = Geodetic(latitude, 8.0, 0.0)
    east = enu_from_geodetic(Geodetic(latitude, 8.001, 0.0), origin)[0]
    assert east == pytest.approx(111.32 * math.cos(math.radians(latitude)), rel=4e-3)


@given(places)
def test_axes_point_east_north_and_up(origin: Geodetic) -> None:
    step = 1e-5
    north = enu_from_geodetic(origin._replace(latitude=origin.latitude + step), origin)
    east = enu_from_geodetic(origin._replace(longitude=origin.longitude + step), origin)
    up = enu_from_geodetic(origin._replace(altitude=origin.altitude + 1), origin)
    np.testing.assert_allclose(north / np.linalg.norm(north), [0, 1, 0], atol=1e-5)
    np.testing.assert_allclose(east / np.linalg.norm(east), [1, 0, 0], atol=1e-5)
    np.testing.assert_allclose(up, [0, 0, 1], atol=1e-6)
