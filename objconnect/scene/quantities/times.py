"""When a photograph was taken: the clock of the camera, checked by that of its receiver.

``DateTimeOriginal`` is local time. ``OffsetTimeOriginal`` tells its zone, which many drones leave
out; the time then counts as UTC. ``GPSTimeStamp`` is UTC.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Final

from objconnect.scene.quantities.numbers import plain_text, to_number
from objconnect.scene.quantities.reading import Reading, known, unknown

# Clocks of cameras are set by hand: they may be off by so much (s).
_APART_S: Final = 600.0
_DAY_S: Final = 86_400.0


def read_time(detail: Mapping[str, object], gps: Mapping[str, object]) -> Reading[datetime]:
    """Return when a photograph was taken, in UTC, with the decimal fraction of a second.

    Without an offset from UTC, the time counts as UTC.

    Args:
        detail: Fields of EXIF by name.
        gps: Fields of EXIF's GPS directory by name.
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
    apart = _apart(time, gps)
    if abs(apart) <= _APART_S:
        return known(time, source)
    field = "OffsetTimeOriginal" if zoned else f"{source} (OffsetTimeOriginal is missing)"
    return known(time, source, f"{field} contradicts GPSTimeStamp by {abs(apart) / 3600:.1f} h")


def _apart(time: datetime, gps: Mapping[str, object]) -> float:
    """Return by how much a time is later than that of the receiver, seconds; 0 if that is none."""
    stamp = gps.get("GPSTimeStamp")
    if not isinstance(stamp, Sequence) or isinstance(stamp, str | bytes) or len(stamp) != 3:
        return 0.0
    hours, minutes, seconds = map(to_number, stamp)
    of_day = 3600 * hours + 60 * minutes + seconds
    if not 0 <= of_day <= _DAY_S:
        return 0.0
    try:
        day = datetime.strptime(plain_text(gps.get("GPSDateStamp")), "%Y:%m:%d").replace(tzinfo=UTC)
    except ValueError:
        ours = 3600 * time.hour + 60 * time.minute + time.second
        return math.remainder(ours - of_day, _DAY_S)
    return (time - day).total_seconds() - of_day
