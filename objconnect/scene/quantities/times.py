"""The time of a photograph: the camera's clock, checked against GPS time.

``DateTimeOriginal`` is local time with the offset ``OffsetTimeOriginal``; without the offset, which
many drones omit, it is taken as UTC. ``GPSTimeStamp`` is UTC.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Final

from objconnect.scene.quantities.numbers import plain_text, to_number
from objconnect.scene.quantities.reading import Reading, known, unknown

# Tolerated error of a camera's clock (s).
_CLOCK_ERROR_S: Final = 600.0
_DAY_S: Final = 86_400.0


def read_time(detail: Mapping[str, object], gps: Mapping[str, object]) -> Reading[datetime]:
    """Return the time of a photograph in UTC, with fractions of a second.

    Args:
        detail: fields of EXIF by name.
        gps: fields of EXIF's GPS directory by name.
    """
    source = "DateTimeOriginal"
    stamp = detail.get(source)
    digits = plain_text(detail.get("SubsecTimeOriginal"))
    offset = plain_text(detail.get("OffsetTimeOriginal"))
    try:
        time = datetime.strptime(str(stamp), "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
        zoned = False
        with suppress(ValueError):
            time = datetime.strptime(f"{stamp}{offset}", "%Y:%m:%d %H:%M:%S%z")
            zoned = True
        time = time.astimezone(UTC)
        time += timedelta(seconds=float(f"0.{digits}") if digits.isdecimal() else 0)
    except (ValueError, OverflowError):  # a datetime ends with the year 9999
        return unknown(source)
    error_s = abs(_clock_error(time, gps))
    if error_s <= _CLOCK_ERROR_S:
        return known(time, source)
    field = "OffsetTimeOriginal" if zoned else f"{source} (OffsetTimeOriginal is missing)"
    return known(time, source, f"{field} contradicts GPSTimeStamp by {error_s / 3600:.1f} h")


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
