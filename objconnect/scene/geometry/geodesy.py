"""Conversion between geodetic coordinates (WGS84) and local east-north-up metres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

# The ellipsoid WGS84: semi-major axis (m), flattening, squared eccentricity.
_SEMI_MAJOR = 6_378_137.0
_FLATTENING = 1 / 298.257223563
_E2 = _FLATTENING * (2 - _FLATTENING)


class Geodetic(NamedTuple):
    """Latitude and longitude in degrees, altitude in metres above the ellipsoid.

    An unknown altitude is NaN; in this module only ``median_place`` accepts one.
    """

    latitude: float
    longitude: float
    altitude: float


FARTHEST_M: Final = 1e8
"""Largest accepted distance of a point from a map's origin (m). A file with larger coordinates is
damaged, and powers of them overflow."""

# Largest altitude of an aircraft (m).
_MAX_ALTITUDE_M = 1e6
# A centimetre along a meridian, in degrees.
_CENTIMETRE_DEG = 1e-7


def is_on_earth(place: Geodetic) -> bool:
    """Return whether coordinates are in range for an aircraft; False for NaN."""
    lat, lon, alt = place
    return abs(lat) <= 90 and abs(lon) <= 180 and abs(alt) <= _MAX_ALTITUDE_M


def is_same_place(a: Geodetic, b: Geodetic, up_m: float = 0.01) -> bool:
    """Return whether two places are within a centimetre horizontally and ``up_m`` vertically."""
    horizontal_deg = max(abs(a.latitude - b.latitude), abs(a.longitude - b.longitude))
    return horizontal_deg <= _CENTIMETRE_DEG and abs(a.altitude - b.altitude) <= up_m


def ecef_from_geodetic(place: Geodetic) -> NDArray[np.float64]:
    """Return earth-centred, earth-fixed coordinates, (3,) metres."""
    lat, lon = math.radians(place.latitude), math.radians(place.longitude)
    n = _SEMI_MAJOR / math.sqrt(1 - _E2 * math.sin(lat) ** 2)
    return np.array(
        [
            (n + place.altitude) * math.cos(lat) * math.cos(lon),
            (n + place.altitude) * math.cos(lat) * math.sin(lon),
            (n * (1 - _E2) + place.altitude) * math.sin(lat),
        ]
    )


def enu_axes(origin: Geodetic) -> NDArray[np.float64]:
    """Return the axes east, north and up in earth-centred coordinates, rows of (3, 3)."""
    lat, lon = math.radians(origin.latitude), math.radians(origin.longitude)
    sl, cl, so, co = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    return np.array([[-so, co, 0], [-sl * co, -sl * so, cl], [cl * co, cl * so, sl]])


def enu_from_geodetic(place: Geodetic, origin: Geodetic) -> NDArray[np.float64]:
    """Return east, north and up of ``place``, (3,) metres from ``origin``.

    Examples:
        >>> origin = Geodetic(47.0, 8.0, 400.0)
        >>> east, north, up = enu_from_geodetic(Geodetic(47.001, 8.0, 450.0), origin)
        >>> f"{north:.2f} m north, {up:.2f} m up"
        '111.18 m north, 50.00 m up'
    """
    return np.asarray(enu_axes(origin) @ (ecef_from_geodetic(place) - ecef_from_geodetic(origin)))


def geodetic_from_enu(enu: NDArray[np.float64], origin: Geodetic) -> Geodetic:
    """Return the geodetic coordinates of a local position (3,), metres from ``origin``.

    The result is exact to well under a millimetre.

    Examples:
        >>> place = geodetic_from_enu(np.array([100.0, 0.0, 0.0]), Geodetic(47.0, 8.0, 400.0))
        >>> f"{place.latitude:.6f} {place.longitude:.6f} {place.altitude:.3f}"
        '47.000000 8.001315 400.001'
    """
    ecef = ecef_from_geodetic(origin) + enu_axes(origin).T @ np.asarray(enu, dtype=np.float64)
    return geodetic_from_ecef(ecef)


def geodetic_from_ecef(ecef: NDArray[np.float64]) -> Geodetic:
    """Convert earth-centred, earth-fixed coordinates (3,) in metres to geodetic ones.

    The result is exact to well under a millimetre.
    """
    x, y, z = ecef
    p = math.hypot(x, y)
    lat = math.atan2(z, p * (1 - _E2))
    for _ in range(6):  # every iteration multiplies the error by about _E2, 0.007
        n = _SEMI_MAJOR / math.sqrt(1 - _E2 * math.sin(lat) ** 2)
        lat = math.atan2(z + _E2 * n * math.sin(lat), p)
    n = _SEMI_MAJOR / math.sqrt(1 - _E2 * math.sin(lat) ** 2)
    # This form of the altitude is stable at the poles and at the equator.
    altitude = p * math.cos(lat) + z * math.sin(lat) - _SEMI_MAJOR**2 / n
    return Geodetic(math.degrees(lat), math.degrees(math.atan2(y, x)), altitude)


def geodetics_from_enu(enu: NDArray[np.float64], origin: Geodetic) -> NDArray[np.float64]:
    """Return latitude, longitude and altitude, (N, 3), of local positions (N, 3).

    Units and exactness are those of ``geodetic_from_enu``.
    """
    x, y, z = (ecef_from_geodetic(origin) + enu @ enu_axes(origin)).T
    p = np.hypot(x, y)
    lat = np.arctan2(z, p * (1 - _E2))
    for _ in range(6):
        n = _SEMI_MAJOR / np.sqrt(1 - _E2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + _E2 * n * np.sin(lat), p)
    n = _SEMI_MAJOR / np.sqrt(1 - _E2 * np.sin(lat) ** 2)
    altitude = p * np.cos(lat) + z * np.sin(lat) - _SEMI_MAJOR**2 / n
    return np.stack([np.degrees(lat), np.degrees(np.arctan2(y, x)), altitude], -1)


def median_place(places: Sequence[Geodetic]) -> Geodetic:
    """Return the median of places, also across longitude 180.

    Longitudes are measured from the longitude of the median earth-centred position, so that they do
    not wrap. Unknown altitudes are ignored; if all are unknown, the median is NaN.
    """
    with_altitudes = [p._replace(altitude=0.0) if math.isnan(p.altitude) else p for p in places]
    x, y, _ = np.median([ecef_from_geodetic(place) for place in with_altitudes], axis=0).tolist()
    # Longitude of the median of the earth-centred positions.
    middle = math.degrees(math.atan2(y, x))
    unwrapped = [middle + longitude_difference(place.longitude, middle) for place in places]
    latitude = float(np.median([place.latitude for place in places]))
    altitudes = [place.altitude for place in places if not math.isnan(place.altitude)]
    altitude = float(np.median(altitudes)) if altitudes else math.nan
    return Geodetic(latitude, longitude_difference(float(np.median(unwrapped)), 0.0), altitude)


def longitude_difference(longitude: float, origin: float) -> float:
    """Return the difference of two longitudes, degrees in [-180, 180)."""
    difference = longitude - origin
    # Wrap only if needed, because the modulo rounds.
    return difference if -180 <= difference < 180 else (difference + 180) % 360 - 180
