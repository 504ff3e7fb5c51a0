"""Where a photograph was taken: latitude and longitude of EXIF, of XMP, or unknown."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Final

from objconnect.scene.quantities.angles import (
    LATITUDE,
    LONGITUDE,
    Axis,
    parse_coordinate,
    read_coordinate,
    read_degrees,
)
from objconnect.scene.quantities.numbers import plain_text
from objconnect.scene.quantities.reading import Reading, known, unknown

LatLon = tuple[float, float]
"""Latitude and longitude, degrees."""

# Positions of one photograph may differ by a correction afterwards, and by short numbers (m).
_APART_M: Final = 100.0
_METRES_PER_DEGREE: Final = 111_320.0
# Names of XMP's fields, without prefix and in lower case. The second is a slip of DJI's.
_XMP: Final = (
    ("GpsLatitude", ("GpsLongitude", "GpsLongtitude")),
    ("Latitude", ("Longitude",)),
    ("GPSLatitude", ("GPSLongitude",)),
)
# The only one whose values have a letter and no sign.
_LETTERED: Final = "GPSLatitude"
# Datums that lie within a few metres of each other.
_DATUMS: Final = (
    *("wgs84", "wgs1984", "epsg4326", "itrf", "etrs89", "gda94", "gda2020"),
    *("nad83", "jgd2000", "jgd2011", "cgcs2000", "sirgas2000"),
)


def read_position(gps: Mapping[str, object], xmp: Mapping[str, str]) -> Reading[LatLon]:
    """Return where a photograph was taken.

    EXIF's position counts where it is whole, and XMP's where it is not. Where they contradict each
    other, the position is unknown.

    Args:
        gps: Fields of EXIF's GPS directory by name.
        xmp: Fields of XMP by name without prefix.
    """
    said = _of_xmp(xmp)
    if not any(axis.tag in gps for axis in (LATITUDE, LONGITUDE)):
        return said
    told = _of_exif(gps)
    if told.value is not None and said.value is not None:
        apart = apart_m(told.value, said.value)
        if apart > _APART_M:
            return unknown(told.source, *_contradict(said.source, apart))
        return told
    if told.value is not None:
        return told.with_doubts(*said.doubts)
    if said.value is None:
        return told.with_doubts(*said.doubts)
    sizes = [
        read_degrees(gps.get(axis.tag), axis).value if axis.tag in gps else None
        for axis in (LATITUDE, LONGITUDE)
    ]
    unsigned = [
        abs(value) if size is None else size for value, size in zip(said.value, sizes, strict=True)
    ]
    apart = apart_m((unsigned[0], unsigned[1]), (abs(said.value[0]), abs(said.value[1])))
    no_fix = sizes == [0, 0]
    if apart > _APART_M and not no_fix:
        return unknown(told.source, *told.doubts, *_contradict(said.source, apart))
    return known(said.value, said.source, *told.doubts, f"the position is that of {said.source}")


def apart_m(first: LatLon, second: LatLon) -> float:
    """Return roughly how far two places are from each other, metres."""
    north = first[0] - second[0]
    east = (first[1] - second[1] + 180) % 360 - 180
    across = math.cos(math.radians(min(abs(first[0]), abs(second[0]))))
    return math.hypot(north, east * across) * _METRES_PER_DEGREE


def _contradict(source: str, apart: float) -> tuple[str]:
    far = f"{apart / 1000:.0f} km" if apart > 2000 else f"{apart:.0f} m"
    return (f"GPSLatitude and GPSLongitude contradict {source} by {far}",)


def _of_exif(gps: Mapping[str, object]) -> Reading[LatLon]:
    source = f"{LATITUDE.tag} and {LONGITUDE.tag}"
    latitude, longitude = (
        read_coordinate(gps.get(axis.tag), gps.get(axis.reference), axis)
        for axis in (LATITUDE, LONGITUDE)
    )
    if latitude.value is None or longitude.value is None:
        return unknown(source, *latitude.doubts, *longitude.doubts)
    if latitude.value == longitude.value == 0:
        return unknown(source, f"{source} are 0, as of a receiver without a fix")
    datum = re.sub(r"[^a-z0-9]", "", plain_text(gps.get("GPSMapDatum")).lower())
    if datum and not datum.startswith(_DATUMS):
        name = plain_text(gps.get("GPSMapDatum"))
        return unknown(source, f"GPSMapDatum {name!r} is not WGS84")
    # A receiver that has lost its satellites goes on with the last position.
    void = plain_text(gps.get("GPSStatus")).upper() == "V"
    doubts = ["GPSStatus V says that the receiver had no fix"] if void else []
    return known((latitude.value, longitude.value), source, *doubts)


def _of_xmp(xmp: Mapping[str, str]) -> Reading[LatLon]:
    """Return XMP's position; unknown where two of its own contradict each other."""
    found: Reading[LatLon] = unknown("XMP")
    for latitude, longitudes in _XMP:
        longitude = next((name for name in longitudes if name in xmp), longitudes[0])
        if latitude not in xmp and longitude not in xmp:
            continue
        one = _pair(xmp, latitude, longitude)
        if one.value is not None and found.value is not None:
            apart = apart_m(one.value, found.value)
            if apart > _APART_M:
                why = f"{found.source} and {one.source} contradict each other in XMP"
                return unknown("XMP", why)
        elif one.value is not None or found.value is None:
            found = one.with_doubts(*found.doubts)
    return found


def _pair(xmp: Mapping[str, str], latitude: str, longitude: str) -> Reading[LatLon]:
    source = f"XMP's {latitude} and {longitude}"
    values: list[float] = []
    doubts: list[str] = []
    for name, axis in ((latitude, LATITUDE), (longitude, LONGITUDE)):
        read = _one(xmp, name, axis, signed=latitude != _LETTERED)
        doubts += read.doubts
        values += [] if read.value is None else [read.value]
    if len(values) < 2:
        return unknown(source, *doubts)
    if values == [0, 0]:
        return unknown(source, f"{source} are 0, as of a receiver without a fix")
    return known((values[0], values[1]), source)


def _one(xmp: Mapping[str, str], name: str, axis: Axis, *, signed: bool) -> Reading[float]:
    if name not in xmp:
        return unknown(name, f"XMP's {name} is missing")
    return parse_coordinate(xmp[name], axis, f"XMP's {name}", signed=signed)
