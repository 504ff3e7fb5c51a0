"""Compute the position of the sun by Meeus' low-precision formulas, as in NOAA's solar calculator.

Source: Jean Meeus, Astronomical Algorithms, 2nd edition, chapters 12, 13 and 25. The error is below
0.01 degrees between 1950 and 2050. Refraction is left out; it is under 0.1 degrees when the sun is
more than 10 degrees above the horizon.
"""

from __future__ import annotations

from datetime import UTC, datetime
from math import asin, atan2, cos, degrees, radians, sin, tan
from typing import NamedTuple

from objconnect.scene.geometry.geodesy import Geodetic

_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)


class SunPosition(NamedTuple):
    """Azimuth clockwise from north, 0 to 360, and elevation above the horizon, in degrees."""

    azimuth: float
    elevation: float


def sun_position(time: datetime, position: Geodetic) -> SunPosition:
    """Return the sun's geometric position at a time with a time zone, seen from a position."""
    days = (time - _J2000).total_seconds() / 86400
    right_ascension, declination = sun_equatorial(days)
    sidereal = 280.46061837 + 360.98564736629 * days
    hour_angle = radians(sidereal + position.longitude) - right_ascension
    latitude = radians(position.latitude)
    elevation = asin(
        sin(latitude) * sin(declination) + cos(latitude) * cos(declination) * cos(hour_angle)
    )
    from_south = atan2(
        sin(hour_angle), cos(hour_angle) * sin(latitude) - tan(declination) * cos(latitude)
    )
    return SunPosition((degrees(from_south) + 180) % 360, degrees(elevation))


def sun_equatorial(days: float) -> tuple[float, float]:
    """Return the apparent right ascension and declination in radians, ``days`` after J2000.0."""
    t = days / 36525  # Julian centuries
    anomaly = radians(357.52911 + 35999.05029 * t - 0.0001537 * t * t)
    centre = (
        (1.914602 - 0.004817 * t - 0.000014 * t * t) * sin(anomaly)
        + (0.019993 - 0.000101 * t) * sin(2 * anomaly)
        + 0.000289 * sin(3 * anomaly)
    )
    node = radians(125.04 - 1934.136 * t)
    true_longitude = 280.46646 + 36000.76983 * t + 0.0003032 * t * t + centre
    longitude = radians(true_longitude - 0.00569 - 0.00478 * sin(node))
    obliquity = radians(23.439291 - 0.0130042 * t + 0.00256 * cos(node))
    right_ascension = atan2(cos(obliquity) * sin(longitude), cos(longitude))
    return right_ascension, asin(sin(obliquity) * sin(longitude))
