"""The flight data that drones write into the subtitles of their videos.

There is no standard; each family of drones has its own words. The reader knows these, which differ
by model and firmware (issues 1741, 1757, 1761 and 1805 of OpenDroneMap/ODM, and the samples of
JuanIrache/DJI_SRT_Parser):

- in brackets, ``[latitude: 47.1] [longitude: 8.5] [rel_alt: 60.0 abs_alt: 512.3] [gb_yaw: 10.0
  gb_pitch: -90.0 gb_roll: 0.0]``, as of Mavic 3, Mini 3 and later ones; Air 2 writes ``altitude``
  alone, and Mavic 2 ``longtitude``;
- compact, ``GPS (8.5, 47.1, 17), D 20.1m, H 60.0m, G.PRY (-90.0°, 0.0°, 10.0°)``, as of Mini 2 and
  Mavic Pro, and ``RTK (...)`` of Phantom 4 RTK;
- ``GPS(8.5,47.1,17) BAROMETER:60.0`` with ``HOME(...)`` before it, as of Phantom 4;
  ``GPS(47.1,8.5,0.0M) BAROMETER:60.0M``, as of Matrice 300; ``GPS(47.1,8.5,512.3)
  BAROMETER(60.0)``, as of Avata 2;
- ``GPS(E: 8.5, N: 47.1, 512.30m)``, as of Autel EVO: with letters, and an altitude.

Some begin pairs with the longitude and others with the latitude, and the words do not tell which.
Checks do (``quantities.coordinate_order``). So it is with the units of focal lengths and zoom
(``quantities.film_lens``) and with decimal commas (``quantities.decimal_marks``). What
no check tells is unknown, and a warning says so.
"""

from __future__ import annotations

import logging
import re
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Final

from objconnect.ingestion.caption_lenses import ZOOMS, lenses_of
from objconnect.ingestion.caption_places import LATITUDES, LONGITUDES, places_of
from objconnect.ingestion.captions import Caption, angle, parts_of, quantity, split_letter
from objconnect.scene.errors import InputError
from objconnect.scene.quantities.coordinate_order import Pair
from objconnect.scene.quantities.decimal_marks import DecimalMarks
from objconnect.scene.quantities.lengths import metres_per
from objconnect.scene.storage.subtitles import read_subtitles
from objconnect.scene.storage.xmp import TURNS

log = logging.getLogger(__name__)

_REL_ALTS: Final = ("rel_alt", "barometer", "hb", "h")
_ABS_ALTS: Final = ("abs_alt",)
_GIMBAL: Final = ("gb_yaw", "gb_pitch", "gb_roll")
_NUMBERS: Final = (
    *(*LATITUDES, *LONGITUDES, *_REL_ALTS, *_ABS_ALTS, *_GIMBAL, *ZOOMS),
    *("focal_len", "fnum", "f-num", "d", "h.s"),
)
_TIME: Final = re.compile(
    r"\b(\d{4})[-.](\d{1,2})[-.](\d{1,2})(?:\s+|T)(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d{1,6}))?"
    r"(?:[.,]\d{1,3})?\s?([AaPp][Mm]\b|Z\b|[-+]\d{2}:?\d{2}\b)?"
)
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
        focal_mm: focal length on 35 mm film, millimetres, without digital zoom.
        time: clock of the drone, in UTC where it names a time zone.
        zoom: digital zoom, a ratio by which it multiplies the focal length; 1 where the file tells
            of none.
        frame: number of the frame, which counts from 1.
        place_doubts: why position, heights and attitude that it tells are unknown, a phrase each.
        lens_doubts: why its focal length or zoom is unknown, or how it was told.
    """

    start_s: float
    end_s: float
    place: tuple[float, float] | None = None
    rel_alt: float | None = None
    abs_alt: float | None = None
    gimbal: tuple[float, float, float] | None = None
    focal_mm: float | None = None
    time: datetime | None = None
    zoom: float | None = 1.0
    frame: int | None = None
    place_doubts: tuple[str, ...] = ()
    lens_doubts: tuple[str, ...] = ()

    @property
    def effective_mm(self) -> float | None:
        """Return the focal length on 35 mm film with the digital zoom, millimetres."""
        if self.focal_mm is None or self.zoom is None:
            return None
        return self.focal_mm * self.zoom


def read_telemetry(
    path: Path, near: Pair | None = None, lenses: Sequence[float] = ()
) -> list[Telemetry]:
    """Read the telemetry of a video's SRT file, in the order of its times.

    A fix at latitude 0 and longitude 0 is none: drones write it before they have one. So is a
    number that no drone can have. What cannot be told for sure is unknown, and a warning of one
    line names the field.

    Args:
        path: SRT file.
        near: latitude and longitude of the map, degrees, which tell the order of pairs.
        lenses: focal lengths of the map's cameras on 35 mm film, millimetres, which tell the unit
            of focal lengths.

    Raises:
        InputError: the file cannot be read, or no subtitle says anything of the flight.
    """
    captions = [Caption.of(subtitle) for subtitle in read_subtitles(path)]
    marks = DecimalMarks.of(number for caption in captions for number in caption.numbers(*_NUMBERS))
    places = places_of(captions, marks, near)
    lens = lenses_of(captions, marks, lenses)
    heights = _Heights.of(captions, marks)
    attitudes, odd = _attitudes(captions, marks)
    flight = [
        Telemetry(
            caption.subtitle.start_s,
            caption.subtitle.end_s,
            place=place,
            rel_alt=heights.first(caption, _REL_ALTS),
            abs_alt=heights.above_sea(caption),
            gimbal=gimbal,
            focal_mm=focal_mm,
            time=_time(caption.text),
            zoom=zoom,
            frame=_frame(caption.fields),
            place_doubts=(
                *([places.of_each[row]] if row in places.of_each else []),
                *heights.why_unknown(caption),
                *([odd] if odd and gimbal is None else []),
            ),
            lens_doubts=lens.of_each[row],
        )
        for row, (caption, place, gimbal, focal_mm, zoom) in enumerate(
            zip(captions, places.places, attitudes, lens.focals, lens.zooms, strict=True)
        )
    ]
    doubts = (*places.doubts, *heights.doubts, *([odd] if odd else []), *lens.doubts)
    if all(_says_nothing(item) for item in flight):
        why = f" ({'; '.join(doubts)})" if doubts else ""
        raise InputError(
            f"{path} has {len(flight)} subtitles, and none tells position, height or gimbal{why}: "
            "give the SRT file that the drone wrote"
        )
    for doubt in doubts:
        log.warning("%s: %s", path, doubt)
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


@dataclass(frozen=True)
class _Heights:
    """Heights of a file, whose units are written beside them or metres.

    Attributes:
        marks: decimal marks of the file.
        plain: whether a height without a unit is in metres; in a file with another unit it is not
            known in which.
        doubts: why heights are unknown.
    """

    marks: DecimalMarks
    plain: bool
    doubts: tuple[str, ...]

    @staticmethod
    def of(captions: Sequence[Caption], marks: DecimalMarks) -> _Heights:
        units: dict[str, str] = {}
        doubts: dict[str, None] = {}
        for caption in captions:
            for name in (*_REL_ALTS, *_ABS_ALTS):
                if name in caption.fields:
                    number, unit = quantity(caption.fields[name], marks)
                    units[unit] = f"{name} {caption.fields[name][:40]}"
                    if number is None or (unit and metres_per(unit) is None):
                        doubts[f"height {name} {caption.fields[name][:40]} is not understood"] = (
                            None
                        )
        others = [unit for unit in units if unit and metres_per(unit) != 1]
        if others and "" in units:
            doubts[f"the unit of height {units['']} is not told"] = None
        return _Heights(marks, not others, tuple(doubts)[:2])

    def first(self, caption: Caption, names: Sequence[str]) -> float | None:
        """Return the first height that is one, metres."""
        values = (self._metres(caption.fields[name]) for name in names if name in caption.fields)
        return next((value for value in values if value is not None), None)

    def above_sea(self, caption: Caption) -> float | None:
        """Return the altitude, metres, also the third number of a pair with letters.

        That of other pairs counts satellites, or does not say above what it is.
        """
        height = self.first(caption, _ABS_ALTS)
        parts = parts_of(caption.tuples.get("gps", ""))
        if height is not None or len(parts) != 3 or not split_letter(parts[0])[0]:
            return height
        return self._metres(parts[2]) if quantity(parts[2], self.marks)[1] else None

    def why_unknown(self, caption: Caption) -> list[str]:
        """Return why heights that a subtitle tells are unknown."""
        told = [name for name in (*_REL_ALTS, *_ABS_ALTS) if name in caption.fields]
        return [
            f"height {name} {caption.fields[name][:40]} is unknown"
            for name in told
            if self._metres(caption.fields[name]) is None
        ]

    def _metres(self, text: str) -> float | None:
        number, unit = quantity(text, self.marks)
        metres = metres_per(unit) if unit else 1.0 if self.plain else None
        if number is None or metres is None or abs(number * metres) >= _HIGHEST_M:
            return None
        return number * metres


def _attitudes(
    captions: Sequence[Caption], marks: DecimalMarks
) -> tuple[list[tuple[float, float, float] | None], str]:
    """Return yaw, pitch and roll of each subtitle, and why some are not believed.

    They are None where one of them is not known. Where all are whole numbers and some are no
    angles, they are in another unit than degrees.
    """
    angles = [_gimbal(caption, marks) for caption in captions]
    off = [found for found in angles if found is not None and not _fits(found)]
    if not off:
        return list(angles), ""
    whole = all(value.is_integer() for found in angles if found is not None for value in found)
    kept = [found if not whole and found is not None and _fits(found) else None for found in angles]
    yaw, pitch, roll = off[0]
    return kept, f"the gimbal's yaw {yaw:g}, pitch {pitch:g}, roll {roll:g} are no angles"


def _fits(angles: tuple[float, float, float]) -> bool:
    return all(abs(angle) <= most for angle, most in zip(angles, TURNS, strict=True))


def _gimbal(caption: Caption, marks: DecimalMarks) -> tuple[float, float, float] | None:
    if any(name in caption.fields for name in _GIMBAL):
        yaw, pitch, roll = (angle(caption.fields.get(name), marks) for name in _GIMBAL)
    elif len(parts := parts_of(caption.tuples.get("g.pry", ""))) == 3:
        pitch, roll, yaw = (angle(part, marks) for part in parts)
    else:
        return None
    return None if yaw is None or pitch is None or roll is None else (yaw, pitch, roll)


def _frame(fields: Mapping[str, str]) -> int | None:
    text = fields.get("framecnt", "").strip()
    return int(text) if text.isdecimal() and len(text) < 10 else None


def _time(text: str) -> datetime | None:
    found = _TIME.search(text)
    if found is None:
        return None
    year, month, day, hour, minute, second = (int(part) for part in found.groups()[:6])
    microsecond = int((found[7] or "0").ljust(6, "0"))
    zone = (found[8] or "").upper()
    try:
        if zone in ("AM", "PM"):
            if not 1 <= hour <= 12:
                return None
            hour = hour % 12 + (12 if zone == "PM" else 0)
        time = datetime(year, month, day, hour, minute, second, microsecond)
        if zone[:1] in ("+", "-"):
            # A time with its zone is told in UTC.
            time -= int(f"{zone[0]}1") * timedelta(hours=int(zone[1:3]), minutes=int(zone[-2:]))
        return time
    except (ValueError, OverflowError):
        return None
