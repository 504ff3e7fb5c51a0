"""Coordinates as polynomials, against the exact ones."""

from __future__ import annotations

import numpy as np
import pytest

from objconnect.scene.geo.crs import Projection
from objconnect.scene.geo.local_coordinates import LocalProjection, world_from_coordinates
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu

ORIGIN = Geodetic(47.0, 8.0, 450.0)


@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:2056", "EPSG:31467"])
def test_coordinates_are_exact_to_a_tenth_of_a_millimetre(crs: str) -> None:
    low, high = np.array([-300.0, -1000.0, -100.0]), np.array([1700.0, 1000.0, 200.0])
    projection = Projection(crs)
    local = LocalProjection.fit(projection, ORIGIN, low, high)
    points = np.random.default_rng(0).uniform(low, high, (60, 3))
    exact = np.array([projection.from_geodetic(geodetic_from_enu(p, ORIGIN)) for p in points])
    assert np.abs(local.coordinates(points) - exact).max() < 1e-4
    # With a datum of its own, PROJ is back within two millimetres.
    assert np.allclose(world_from_coordinates(projection, ORIGIN, exact), points, atol=2e-3)


def test_a_line_is_a_parabola() -> None:
    low, high = np.full(3, -900.0), np.full(3, 900.0)
    local = LocalProjection.fit(Projection("EPSG:2056"), ORIGIN, low, high)
    start, directions = np.array([100.0, -50, 80]), np.array([[0.3, -0.2, -1.0], [1, 1, 0.1]])
    a, b, c = local.expand_rays(start, directions)
    for t in (0.0, 50.0, 400.0):
        expected = local.coordinates(start + t * directions)
        assert np.allclose(a + b * t + c * t * t, expected, atol=1e-9, rtol=0)
