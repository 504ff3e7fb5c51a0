"""The flight data that drones write into the subtitles of their videos.

There is no standard; each family of drones has its own words. The reader knows these, which differ
by model and firmware (issues 1741, 1757, 1761 and 1805 of OpenDroneMap/ODM, and the samples of
JuanIrache/DJI_SRT_Parser):

- in brackets, ``[latitude: 47.1] [longitude: 8.5] [rel_alt: 60.0 abs_alt: 512.3] [gb_yaw: 10.0
  gb_pitch: -90.0 gb_roll: 0.0]``, as of Mavic 3, Mini 3 and later ones; Air 2 writes ``altitude``
  alone, and Mavic 2 ``longtitude``;
- compact, ``GPS (8.5, 47.1, 17), D 20.1m, H 60.0m, G.PRY (-90.0°, 0.0°, 10.0°)``, as of Mini 2 and
  Mavic Pro, and ``RTK (...)`` of Phantom 4 RTK: longitude first, and then the number of satellites;
- ``GPS(8.5,47.1,17) BAROMETER:60.0`` with ``HOME(...)`` before it, as of Phantom 4: the same order;
- ``GPS(47.1,8.5,0.0M) BAROMETER:60.0M``, as of Matrice 300: latitude first;
- ``GPS(E: 8.5, N: 47.1, 512.30m)``, as of Autel EVO: with letters, and an altitude.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Final, Literal

from scene.errors import InputError
from scene.storage.subtitles import Subtitle, read_subtitles

Order = Literal["longitude", "latitude"]

_NUMBER: Final = r"[-+]?\d++(?:\.\d++)?+"
# The second stands for a byte of another encoding.
_DEGREE: Final = "[°\ufffd]?"
_TAG: Final = re.compile(r"<[^<>]*>")
_KEY: Final = re.compile(rf"\b(\w+)\s*:\s*({_NUMBER})(?![/eE.])")
_PAIR: Final = re.compile(
    rf"\b(?:GPS|RTK)\s*\(\s*(?:([NSEW])\s*:\s*)?({_NUMBER})\s*,\s*(?:([NSEW])\s*:\s*)?({_NUMBER})"
    rf"(?:\s*,\s*({_NUMBER})\s*(m|M)?)?\s*\)"
)
_GIMBAL: Final = re.compile(
    rf"\bG\.PRY\s*\(\s*({_NUMBER}){_DEGREE}\s*,\s*({_NUMBER}){_DEGREE}\s*,\s*({_NUMBER})"
)
# The height of compact subtitles; "H.S" is a speed and "HOME" a place.
_HEIGHT: Final = re.compile(rf"(?<![\w.])H\s+({_NUMBER})\s*m\b")
_TIME: Final = re.compile(
    r"\b(\d{4})[-.](\d{1,2})[-.](\d{1,2})\s+(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d{1,3}))?"
)
# A larger focal length (mm) is written in tenths.
_LONGEST_MM: Final = 100.0
_HIGHEST_M: Final = 1e5


@dataclass(frozen=True)
class Telemetry:
    """What a subtitle says of the flight. None stands for what it does not say.

    Attributes:
        start_s: seconds from the start of the video at which it begins to hold.
        end_s: seconds from the start of the video at which it ends.
        place: latitude and longitude, degrees.
        rel_alt: height above the place of take-off, metres.
        abs_alt: altitude above sea level, metres, by a barometer: it may be off by tens of metres.
        gimbal: yaw (clockwise from north), pitch (above the horizon) and roll, degrees.
        focal_mm: focal length on 35 mm film, millimetres.
        time: clock of the drone, which names no time zone.
    """

    start_s: float
    end_s: float
    place: tuple[float, float] | None = None
    rel_alt: float | None = None
    abs_alt: float | None = None
    gimbal: tuple[float, float, float] | None = None
    focal_mm: float | None = None
    time: datetime | None = None


def read_telemetry(path: Path) -> list[Telemetry]:
    """Read the telemetry of a video's SRT file, in the order of its times.

    A fix at latitude 0 and longitude 0 is none: drones write it before they have one. So is a
    number that no drone can have.

    Raises:
        InputError: the file cannot be read, or no subtitle says anything of the flight.
    """
    subtitles = read_subtitles(path)
    texts = [_TAG.sub(" ", subtitle.text) for subtitle in subtitles]
    order = _order(texts)
    flight = [
        _parsed(subtitle, text, order) for subtitle, text in zip(subtitles, texts, strict=True)
    ]
    if all(_says_nothing(item) for item in flight):
        raise InputError(
            f"{path} has {len(flight)} subtitles, and none tells position, height or gimbal: give "
            "the SRT file that the drone wrote"
        )
    return flight


def _says_nothing(item: Telemetry) -> bool:
    return all(part is None for part in (item.place, item.gimbal, item.abs_alt, item.rel_alt))


def at_time(flight: Sequence[Telemetry], seconds: float, most_s: float = 1.0) -> Telemetry | None:
    """Return the telemetry of a time of the video.

    Args:
        flight: in the order of times.
        seconds: from the start of the video.
        most_s: telemetry that ended longer ago is that of another time.

    Returns:
        What began last before that time; None where there is none, or it ended long before.
    """
    row = bisect_right(flight, seconds + 1e-6, key=lambda item: item.start_s) - 1
    if row < 0 or seconds > max(flight[row].end_s, flight[row].start_s) + most_s:
        return None
    return flight[row]


def _parsed(subtitle: Subtitle, text: str, order: Order) -> Telemetry:
    """Return what the text (without tags) of a subtitle says."""
    keys = {key.lower(): float(value) for key, value in _KEY.findall(text)}
    pair = _PAIR.search(text)
    rel_alt = _height(keys, "rel_alt", "barometer", "hb")
    if rel_alt is None and (found := _HEIGHT.search(text)):
        rel_alt = _height({"h": float(found[1])}, "h")
    abs_alt = _height(keys, "abs_alt")
    # The third number of a pair with letters is the altitude; else it counts satellites.
    if abs_alt is None and pair is not None and pair[1] and pair[6] == "m":
        abs_alt = _height({"pair": float(pair[5])}, "pair")
    return Telemetry(
        subtitle.start_s,
        subtitle.end_s,
        place=_keyed_place(keys) or _paired_place(pair, order),
        rel_alt=rel_alt,
        abs_alt=abs_alt,
        gimbal=_gimbal(keys, text),
        focal_mm=_focal(keys),
        time=_time(text),
    )


def _order(texts: Sequence[str]) -> Order:
    """Return which number of the pairs without letters comes first.

    A number beyond 90 can only be a longitude. Where there is none, the pair whose third number
    is in ``M`` begins with the latitude, and every other known one with the longitude.
    """
    order: Order = "longitude"
    for text in texts:
        pair = _PAIR.search(text)
        if pair is None or pair[1]:
            continue
        first, second = abs(float(pair[2])), abs(float(pair[4]))
        if first > 90 or second > 90:
            return "longitude" if first > 90 else "latitude"
        if pair[6] == "M":
            order = "latitude"
    return order


def _keyed_place(keys: Mapping[str, float]) -> tuple[float, float] | None:
    longitude = keys.get("longitude", keys.get("longtitude"))
    latitude = keys.get("latitude")
    return None if latitude is None or longitude is None else _on_earth(latitude, longitude)


def _paired_place(pair: re.Match[str] | None, order: Order) -> tuple[float, float] | None:
    if pair is None:
        return None
    first, second = float(pair[2]), float(pair[4])
    if pair[1] or pair[3]:
        towards = {pair[1]: first, pair[3]: second}
        towards |= {"N": -towards["S"]} if "S" in towards else {}
        towards |= {"E": -towards["W"]} if "W" in towards else {}
        return _on_earth(towards["N"], towards["E"]) if {"N", "E"} <= set(towards) else None
    return _on_earth(second, first) if order == "longitude" else _on_earth(first, second)


def _on_earth(latitude: float, longitude: float) -> tuple[float, float] | None:
    if abs(latitude) > 90 or abs(longitude) > 180 or latitude == longitude == 0:
        return None
    return latitude, longitude


def _height(keys: Mapping[str, float], *names: str) -> float | None:
    """Return the first of some heights that is one."""
    values = (keys[name] for name in names if name in keys)
    return next((value for value in values if abs(value) < _HIGHEST_M), None)


def _gimbal(keys: Mapping[str, float], text: str) -> tuple[float, float, float] | None:
    """Return yaw, pitch and roll. Without a yaw nothing is said of the attitude."""
    if "gb_yaw" in keys and "gb_pitch" in keys:
        angles = (keys["gb_yaw"], keys["gb_pitch"], keys.get("gb_roll", 0.0))
    elif found := _GIMBAL.search(text):
        pitch, roll, yaw = (float(number) for number in found.groups())
        angles = (yaw, pitch, roll)
    else:
        return None
    return angles if all(abs(angle) <= 360 for angle in angles) else None


def _focal(keys: Mapping[str, float]) -> float | None:
    """Return the focal length, of which some models write millimetres and others tenths."""
    focal = keys.get("focal_len", 0.0)
    if focal > _LONGEST_MM:
        focal /= 10
    return focal if 1 <= focal <= 10 * _LONGEST_MM and math.isfinite(focal) else None


def _time(text: str) -> datetime | None:
    found = _TIME.search(text)
    if found is None:
        return None
    year, month, day, hour, minute, second = (int(part) for part in found.groups()[:6])
    microsecond = int((found[7] or "0").ljust(3, "0")) * 1000
    try:
        return datetime(year, month, day, hour, minute, second, microsecond)
    except ValueError:
        return None
