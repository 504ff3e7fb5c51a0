"""The latitude and longitude of a photograph from EXIF or XMP."""

from __future__ import annotations

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
from objconnect.scene.quantities.coordinate_order import ground_distance
from objconnect.scene.quantities.numbers import plain_text
from objconnect.scene.quantities.reading import Reading, known, unknown

LatLon = tuple[float, float]
"""Latitude and longitude, degrees."""

# Largest distance of two positions of one photograph, from corrections and rounding (m).
_LARGEST_DISTANCE_M: Final = 100.0

# Names of XMP's fields without prefix. GpsLongtitude is a misspelling of DJI's.
_XMP: Final = (
    ("GpsLatitude", ("GpsLongitude", "GpsLongtitude")),
    ("Latitude", ("Longitude",)),
    ("GPSLatitude", ("GPSLongitude",)),
)
# Latitude field of the pair whose values have a hemisphere letter instead of a sign.
_FIELD_WITH_LETTER: Final = "GPSLatitude"
# Datums that lie within a few metres of each other.
_DATUMS: Final = (
    *("wgs84", "wgs1984", "epsg4326", "itrf", "etrs89", "gda94", "gda2020"),
    *("nad83", "jgd2000", "jgd2011", "cgcs2000", "sirgas2000"),
)


def read_position(gps: Mapping[str, object], xmp: Mapping[str, str]) -> Reading[LatLon]:
    """Return the latitude and longitude of a photograph.

    EXIF's position is used if it is complete, else XMP's. It is unknown if they contradict each
    other.

    Args:
        gps: fields of EXIF's GPS directory by name.
        xmp: fields of XMP by name without prefix.
    """
    from_xmp = _read_xmp(xmp)
    if not any(axis.tag in gps for axis in (LATITUDE, LONGITUDE)):
        return from_xmp
    from_exif = _read_exif(gps)
    if from_exif.value is not None and from_xmp.value is not None:
        distance = ground_distance(from_exif.value, from_xmp.value)
        if distance > _LARGEST_DISTANCE_M:
            return unknown(from_exif.source, _contradiction(from_xmp.source, distance))
        return from_exif
    if from_exif.value is not None or from_xmp.value is None:
        return from_exif.with_doubts(*from_xmp.doubts)
    # EXIF's position is unknown, for example without hemispheres: compare XMP's with its numbers.
    unsigned_exif = [
        read_degrees(gps.get(axis.tag), axis).value if axis.tag in gps else None
        for axis in (LATITUDE, LONGITUDE)
    ]
    unsigned = [
        abs(value) if exif_degrees is None else exif_degrees
        for value, exif_degrees in zip(from_xmp.value, unsigned_exif, strict=True)
    ]
    distance = ground_distance(
        (unsigned[0], unsigned[1]), (abs(from_xmp.value[0]), abs(from_xmp.value[1]))
    )
    no_fix = unsigned_exif == [0, 0]
    if distance > _LARGEST_DISTANCE_M and not no_fix:
        return unknown(
            from_exif.source, *from_exif.doubts, _contradiction(from_xmp.source, distance)
        )
    note = f"the position is taken from {from_xmp.source}"
    return known(from_xmp.value, from_xmp.source, *from_exif.doubts, note)


def _contradiction(source: str, distance: float) -> str:
    text = f"{distance / 1000:.0f} km" if distance > 2000 else f"{distance:.0f} m"
    return f"GPSLatitude and GPSLongitude contradict {source} by {text}"


def _read_exif(gps: Mapping[str, object]) -> Reading[LatLon]:
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
    # A receiver without satellites repeats its last position.
    void = plain_text(gps.get("GPSStatus")).upper() == "V"
    doubts = ["GPSStatus V means that the receiver had no fix"] if void else []
    return known((latitude.value, longitude.value), source, *doubts)


def _read_xmp(xmp: Mapping[str, str]) -> Reading[LatLon]:
    """Return XMP's position; unknown if its fields contradict each other."""
    found: Reading[LatLon] = unknown("XMP")
    for latitude, longitudes in _XMP:
        longitude = next((name for name in longitudes if name in xmp), longitudes[0])
        if latitude not in xmp and longitude not in xmp:
            continue
        one = _read_pair(xmp, latitude, longitude)
        if one.value is not None and found.value is not None:
            if ground_distance(one.value, found.value) > _LARGEST_DISTANCE_M:
                why = f"{found.source} and {one.source} contradict each other in XMP"
                return unknown("XMP", why)
        elif one.value is not None or found.value is None:
            found = one.with_doubts(*found.doubts)
    return found


def _read_pair(xmp: Mapping[str, str], latitude: str, longitude: str) -> Reading[LatLon]:
    source = f"XMP's {latitude} and {longitude}"
    values: list[float] = []
    doubts: list[str] = []
    for name, axis in ((latitude, LATITUDE), (longitude, LONGITUDE)):
        read = _read_field(xmp, name, axis, signed=latitude != _FIELD_WITH_LETTER)
        doubts += read.doubts
        values += [] if read.value is None else [read.value]
    if len(values) < 2:
        return unknown(source, *doubts)
    if values == [0, 0]:
        return unknown(source, f"{source} are 0, as of a receiver without a fix")
    return known((values[0], values[1]), source)


def _read_field(xmp: Mapping[str, str], name: str, axis: Axis, *, signed: bool) -> Reading[float]:
    if name not in xmp:
        return unknown(name, f"XMP's {name} is missing")
    return parse_coordinate(xmp[name], axis, f"XMP's {name}", signed=signed)
