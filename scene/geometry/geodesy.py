"""Local east-north-up metres and geodetic coordinates (WGS84)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_SEMI_MAJOR = 6_378_137.0
_FLATTENING = 1 / 298.257223563
_E2 = _FLATTENING * (2 - _FLATTENING)


class Geodetic(NamedTuple):
    """Latitude and longitude in degrees, altitude in metres above the ellipsoid."""

    latitude: float
    longitude: float
    altitude: float


# No aircraft flies higher, metres.
_HIGHEST = 1e6


def is_on_earth(place: Geodetic) -> bool:
    """Whether a place can be one of a flight: false for numbers that are none, too."""
    lat, lon, alt = place
    return abs(lat) <= 90 and abs(lon) <= 180 and abs(alt) <= _HIGHEST


def _ecef(place: Geodetic) -> NDArray[np.float64]:
    lat, lon = math.radians(place.latitude), math.radians(place.longitude)
    n = _SEMI_MAJOR / math.sqrt(1 - _E2 * math.sin(lat) ** 2)
    return np.array(
        [
            (n + place.altitude) * math.cos(lat) * math.cos(lon),
            (n + place.altitude) * math.cos(lat) * math.sin(lon),
            (n * (1 - _E2) + place.altitude) * math.sin(lat),
        ]
    )


def _enu_axes(origin: Geodetic) -> NDArray[np.float64]:
    """Rows are east, north and up in earth-centred coordinates."""
    lat, lon = math.radians(origin.latitude), math.radians(origin.longitude)
    sl, cl, so, co = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    return np.array([[-so, co, 0], [-sl * co, -sl * so, cl], [cl * co, cl * so, sl]])


def enu_from_geodetic(place: Geodetic, origin: Geodetic) -> NDArray[np.float64]:
    """East, north, up of ``place`` in metres from ``origin``, (3,)."""
    return np.asarray(_enu_axes(origin) @ (_ecef(place) - _ecef(origin)))


def geodetic_from_enu(enu: NDArray[np.float64], origin: Geodetic) -> Geodetic:
    """The geodetic place of local metres (3,). Exact to well under a millimetre."""
    x, y, z = _ecef(origin) + _enu_axes(origin).T @ np.asarray(enu, dtype=np.float64)
    p = math.hypot(x, y)
    lat = math.atan2(z, p * (1 - _E2))
    for _ in range(6):  # converges by a factor of e^2 a turn
        n = _SEMI_MAJOR / math.sqrt(1 - _E2 * math.sin(lat) ** 2)
        lat = math.atan2(z + _E2 * n * math.sin(lat), p)
    n = _SEMI_MAJOR / math.sqrt(1 - _E2 * math.sin(lat) ** 2)
    # This form of the altitude stays stable at the poles as well as at the equator.
    altitude = p * math.cos(lat) + z * math.sin(lat) - _SEMI_MAJOR**2 / n
    return Geodetic(math.degrees(lat), math.degrees(math.atan2(y, x)), altitude)


def amid(places: Sequence[Geodetic]) -> Geodetic:
    """A place amid others, also where they lie on both sides of longitude 180.

    It is the median of each coordinate, so that a few wrong places do not count; longitudes are
    taken from the direction of the median place, seen from the centre of the earth.
    """
    x, y, _ = np.median([_ecef(place) for place in places], axis=0).tolist()
    middle = math.degrees(math.atan2(y, x))
    turned = [middle + turn_between(place.longitude, middle) for place in places]
    latitude = float(np.median([place.latitude for place in places]))
    altitude = float(np.median([place.altitude for place in places]))
    return Geodetic(latitude, turn_between(float(np.median(turned)), 0.0), altitude)


def turn_between(longitude: float, origin: float) -> float:
    """How far a longitude is east of another, at least -180 and less than 180 degrees."""
    difference = longitude - origin
    # A difference within these bounds is exact as it is.
    return difference if -180 <= difference < 180 else (difference + 180) % 360 - 180
