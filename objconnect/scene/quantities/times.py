"""The time of a photograph: the camera's clock, checked against GPS time.

``DateTimeOriginal`` is local time with the offset ``OffsetTimeOriginal``; without the offset, which
many drones omit, it is taken as UTC. Programs also write it in ISO 8601, perhaps with a zone and
fractions of a second. ``GPSTimeStamp`` is UTC.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Final, NamedTuple

from objconnect.scene.quantities.numbers import plain_text, to_number
from objconnect.scene.quantities.reading import Reading, known, unknown

# Tolerated error of a camera's clock (s).
_CLOCK_ERROR_S: Final = 600.0
_DAY_S: Final = 86_400.0
# Longest part of an unreadable field that a doubt repeats, characters.
_QUOTED: Final = 40
_SOURCE: Final = "DateTimeOriginal"
_ISO: Final = re.compile(
    r"(\d{4})-(\d\d)-(\d\d)[T ](\d\d:\d\d:\d\d)(?:[.,](\d+))?(Z|[+-]\d\d:?\d\d)?", re.ASCII
)


class _Stamp(NamedTuple):
    """The texts of a time.

    Attributes:
        time: date and time, in EXIF's spelling if it can be read.
        digits: decimal places of the second; empty if missing.
        offset: offset from UTC; empty if missing.
        offset_field: field of the offset.
    """

    time: str
    digits: str
    offset: str
    offset_field: str


def read_time(detail: Mapping[str, object], gps: Mapping[str, object]) -> Reading[datetime]:
    """Return the time of a photograph in UTC, with fractions of a second.

    Doubts name fields that cannot be read or contradict each other, not a missing time.

    Args:
        detail: fields of EXIF by name.
        gps: fields of EXIF's GPS directory by name.
    """
    stamp = _read_stamp(detail)
    try:
        time = datetime.strptime(stamp.time, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
        zoned = False
        with suppress(ValueError):
            time = datetime.strptime(f"{stamp.time}{stamp.offset}", "%Y:%m:%d %H:%M:%S%z")
            zoned = True
        time = time.astimezone(UTC)
        time += timedelta(seconds=float(f"0.{stamp.digits}") if stamp.digits.isdecimal() else 0)
    except (ValueError, OverflowError):  # a datetime ends with the year 9999
        written = plain_text(detail.get(_SOURCE))[:_QUOTED]
        return unknown(_SOURCE, *([f"{_SOURCE} {written!r} is not a time"] if written else []))
    doubts = []
    if stamp.offset and not zoned:
        doubts.append(f"{stamp.offset_field} {stamp.offset[:_QUOTED]!r} is not an offset from UTC")
    error_s = abs(_clock_error(time, gps))
    if error_s > _CLOCK_ERROR_S:
        missing = f"{_SOURCE} (OffsetTimeOriginal is missing)"
        field = stamp.offset_field if zoned else _SOURCE if stamp.offset else missing
        doubts.append(f"{field} contradicts GPSTimeStamp by {error_s / 3600:.1f} h")
    return known(time, _SOURCE, *doubts)


def _read_stamp(detail: Mapping[str, object]) -> _Stamp:
    """Return the texts of a time in EXIF's or ISO's spelling; ISO's own zone takes precedence."""
    time, digits, offset = (
        plain_text(detail.get(field))
        for field in (_SOURCE, "SubsecTimeOriginal", "OffsetTimeOriginal")
    )
    if (iso := _ISO.fullmatch(time)) is None:
        return _Stamp(time, digits, offset, "OffsetTimeOriginal")
    year, month, day, clock, fraction, zone = iso.groups()
    time, digits = f"{year}:{month}:{day} {clock}", fraction or digits
    return _Stamp(time, digits, zone or offset, _SOURCE if zone else "OffsetTimeOriginal")


def _clock_error(time: datetime, gps: Mapping[str, object]) -> float:
    """Return by how many seconds a time is later than GPS time; 0 if there is no GPS time."""
    stamp = gps.get("GPSTimeStamp")
    if not isinstance(stamp, Sequence) or isinstance(stamp, str | bytes) or len(stamp) != 3:
        return 0.0
    hours, minutes, seconds = map(to_number, stamp)
    gps_s = 3600 * hours + 60 * minutes + seconds
    if not 0 <= gps_s <= _DAY_S:
        return 0.0
    try:
        day = datetime.strptime(plain_text(gps.get("GPSDateStamp")), "%Y:%m:%d").replace(tzinfo=UTC)
    except ValueError:
        camera_s = 3600 * time.hour + 60 * time.minute + time.second
        return math.remainder(camera_s - gps_s, _DAY_S)
    return (time - day).total_seconds() - gps_s
