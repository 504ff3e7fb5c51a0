"""The computed position of the sun against published positions."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from math import degrees

import pytest

from objconnect.scene.geometry.geodesy import Geodetic
from simulate.look.sun import sun_equatorial, sun_position

GREENWICH = Geodetic(51.4779, 0.0, 46.0)


def test_worked_example_of_meeus() -> None:
    """Example 25.a: 1992 October 13, 0 h: right ascension 198.38083, declination -7.78507."""
    ascension, declination = sun_equatorial(2448908.5 - 2451545.0)
    assert degrees(ascension) % 360 == pytest.approx(198.38083, abs=1e-4)
    assert degrees(declination) == pytest.approx(-7.78507, abs=1e-4)


def test_worked_example_of_reda_and_andreas() -> None:
    """NREL's Solar Position Algorithm: zenith 50.11162, azimuth 194.34024."""
    time = datetime(2003, 10, 17, 19, 30, 30, tzinfo=UTC)
    sun = sun_position(time, Geodetic(39.742476, -105.1786, 1830.14))
    assert sun.azimuth == pytest.approx(194.34024, abs=0.05)
    assert sun.elevation == pytest.approx(90 - 50.11162, abs=0.05)  # theirs is refracted


@pytest.mark.parametrize(
    ("day", "declination", "equation_min"),
    [((2025, 6, 21), 23.44, -1.9), ((2025, 11, 3), -15.2, 16.45), ((2026, 2, 11), -14.0, -14.2)],
)
def test_culmination(day: tuple[int, int, int], declination: float, equation_min: float) -> None:
    """Due south at noon less the equation of time, as high as the declination says."""
    time = datetime(*day, 12, tzinfo=UTC) - timedelta(minutes=equation_min)
    sun = sun_position(time, GREENWICH)
    assert sun.azimuth == pytest.approx(180, abs=0.2)
    assert sun.elevation == pytest.approx(90 - GREENWICH.latitude + declination, abs=0.2)


def test_the_southern_sun_culminates_in_the_north_and_rises_in_the_east() -> None:
    place = Geodetic(-33.9, 18.4, 0.0)
    noon = datetime(2025, 6, 21, 12, tzinfo=UTC) - timedelta(hours=18.4 / 15)
    assert abs((sun_position(noon, place).azimuth + 180) % 360 - 180) < 2
    assert 45 < sun_position(noon - timedelta(hours=4), place).azimuth < 90
