"""Read the telemetry that drones write into the subtitles (SRT) of their videos.

There is no standard. The reader supports these formats, which differ by model and firmware (issues
1741, 1757, 1761 and 1805 of OpenDroneMap/ODM, and the samples of JuanIrache/DJI_SRT_Parser):

- in brackets, by Mavic 3, Mini 3 and later models: ``[latitude: 47.1] [longitude: 8.5] [rel_alt:
  60.0 abs_alt: 512.3] [gb_yaw: 10.0 gb_pitch: -90.0 gb_roll: 0.0]``; Air 2 writes ``altitude``
  alone, and Mavic 2 ``longtitude``;
- compact, by Mini 2 and Mavic Pro: ``GPS (8.5, 47.1, 17), D 20.1m, H 60.0m, G.PRY (-90.0°, 0.0°,
  10.0°)``; Phantom 4 RTK writes ``RTK (...)``;
- Phantom 4: ``GPS(8.5,47.1,17) BAROMETER:60.0`` with ``HOME(...)`` before it; Matrice 300:
  ``GPS(47.1,8.5,0.0M) BAROMETER:60.0M``; Avata 2: ``GPS(47.1,8.5,512.3) BAROMETER(60.0)``;
- Autel EVO, with letters and an altitude: ``GPS(E: 8.5, N: 47.1, 512.30m)``.

Some models write the longitude first and others the latitude, and the text does not say which.
Plausibility checks decide the order (``quantities.coordinate_order``), the units of focal lengths
and zoom (``quantities.film_lens``) and decimal commas (``quantities.decimal_marks``). Values that
no check decides are unknown, and a warning says so.
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

from objconnect.ingestion.caption_lenses import ZOOMS, parse_lenses
from objconnect.ingestion.caption_positions import LATITUDES, LONGITUDES, parse_positions
from objconnect.ingestion.captions import (
    Caption,
    parse_angle,
    parse_quantity,
    split_letter,
    split_tuple,
)
from objconnect.scene.errors import InputError
from objconnect.scene.quantities.coordinate_order import Pair
from objconnect.scene.quantities.decimal_marks import DecimalMarks
from objconnect.scene.quantities.lengths import metres_per
from objconnect.scene.storage.subtitles import read_subtitles
from objconnect.scene.storage.xmp import LARGEST_ANGLES

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
_MAX_HEIGHT_M: Final = 1e5


@dataclass(frozen=True)
class Telemetry:
    """The telemetry of one subtitle. Values that it lacks are None.

    Attributes:
        start_s: start of the subtitle, seconds from the start of the video.
        end_s: end of the subtitle, seconds from the start of the video.
        place: latitude and longitude, degrees.
        rel_alt: height above the take-off point, metres.
        abs_alt: altitude above sea level, metres, by a barometer: it may be off by tens of metres.
        gimbal: yaw (clockwise from north), pitch (above the horizon) and roll, degrees.
        focal_mm: 35 mm equivalent focal length, millimetres, without digital zoom.
        time: clock of the drone, in UTC where it names a time zone.
        zoom: digital zoom, the factor on the focal length; 1 where the file has none.
        frame: number of the frame, counted from 1.
        place_doubts: reasons why position, heights and attitude of the text are unknown.
        lens_doubts: reasons why focal length or zoom are unknown, or how they were decided.
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
        """Return the 35 mm equivalent focal length with digital zoom, millimetres."""
        if self.focal_mm is None or self.zoom is None:
            return None
        return self.focal_mm * self.zoom


def read_telemetry(
    path: Path, near: Pair | None = None, lenses: Sequence[float] = ()
) -> list[Telemetry]:
    """Read the telemetry of a video's SRT file, sorted by time.

    Latitude 0 with longitude 0 is treated as no fix, because drones write it before they have one.
    Implausible numbers are dropped. Ambiguous values are unknown, and a one-line warning names the
    field.

    Args:
        path: SRT file.
        near: latitude and longitude of the map, degrees, which decide the order of pairs.
        lenses: 35 mm equivalent focal lengths of the map's cameras, millimetres, which decide the
            unit of focal lengths.

    Raises:
        InputError: the file cannot be read, or no subtitle has telemetry.
    """
    captions = [Caption.parse(subtitle) for subtitle in read_subtitles(path)]
    marks = DecimalMarks.of(number for caption in captions for number in caption.numbers(*_NUMBERS))
    positions = parse_positions(captions, marks, near)
    lens = parse_lenses(captions, marks, lenses)
    heights = _HeightParser.of(captions, marks)
    attitudes, doubt_of_gimbal = _parse_attitudes(captions, marks)
    flight = [
        Telemetry(
            caption.subtitle.start_s,
            caption.subtitle.end_s,
            place=place,
            rel_alt=heights.read_first(caption, _REL_ALTS),
            abs_alt=heights.read_above_sea_level(caption),
            gimbal=gimbal,
            focal_mm=focal_mm,
            time=_parse_time(caption.text),
            zoom=zoom,
            frame=_parse_frame(caption.fields),
            place_doubts=(
                *([positions.doubt_of[row]] if row in positions.doubt_of else []),
                *heights.list_unknown(caption),
                *([doubt_of_gimbal] if doubt_of_gimbal and gimbal is None else []),
            ),
            lens_doubts=lens.doubts_of[row],
        )
        for row, (caption, place, gimbal, focal_mm, zoom) in enumerate(
            zip(captions, positions.values, attitudes, lens.focals, lens.zooms, strict=True)
        )
    ]
    gimbal_doubts = [doubt_of_gimbal] if doubt_of_gimbal else []
    doubts = (*positions.doubts, *heights.doubts, *gimbal_doubts, *lens.doubts)
    if all(_is_empty(item) for item in flight):
        why = f" ({'; '.join(doubts)})" if doubts else ""
        raise InputError(
            f"{path} has {len(flight)} subtitles, and none has position, height or gimbal{why}: "
            "give the SRT file that the drone wrote"
        )
    for doubt in doubts:
        log.warning("%s: %s", path, doubt)
    return flight


def _is_empty(item: Telemetry) -> bool:
    return all(part is None for part in (item.place, item.gimbal, item.abs_alt, item.rel_alt))


def find_telemetry(
    flight: Sequence[Telemetry], seconds: float, max_age_s: float = 1.0
) -> Telemetry | None:
    """Return the telemetry at a time of the video.

    Args:
        flight: telemetry sorted by time.
        seconds: time from the start of the video.
        max_age_s: maximum age, counted from the end of the subtitle, seconds.

    Returns:
        The last telemetry that began before that time; None where there is none or it is too old.
    """
    row = bisect_right(flight, seconds + 1e-6, key=lambda item: item.start_s) - 1
    if row < 0 or seconds > max(flight[row].end_s, flight[row].start_s) + max_age_s:
        return None
    return flight[row]


@dataclass(frozen=True)
class _HeightParser:
    """The parser of a file's heights.

    Attributes:
        marks: decimal marks of the file.
        unitless_is_metres: whether a height without a unit is in metres. It is unknown in a file
            that uses other units.
        doubts: reasons why heights are unknown.
    """

    marks: DecimalMarks
    unitless_is_metres: bool
    doubts: tuple[str, ...]

    @staticmethod
    def of(captions: Sequence[Caption], marks: DecimalMarks) -> _HeightParser:
        units: dict[str, str] = {}
        doubts: dict[str, None] = {}
        for caption in captions:
            for name in (*_REL_ALTS, *_ABS_ALTS):
                if name in caption.fields:
                    number, unit = parse_quantity(caption.fields[name], marks)
                    units[unit] = f"{name} {caption.fields[name][:40]}"
                    if number is None or (unit and metres_per(unit) is None):
                        doubts[f"height {name} {caption.fields[name][:40]} is not understood"] = (
                            None
                        )
        others = [unit for unit in units if unit and metres_per(unit) != 1]
        if others and "" in units:
            doubts[f"height {units['']} has no unit"] = None
        return _HeightParser(marks, not others, tuple(doubts)[:2])

    def read_first(self, caption: Caption, names: Sequence[str]) -> float | None:
        """Return the first valid height of the named fields, metres."""
        values = (self._metres(caption.fields[name]) for name in names if name in caption.fields)
        return next((value for value in values if value is not None), None)

    def read_above_sea_level(self, caption: Caption) -> float | None:
        """Return the altitude above sea level, metres.

        It is a field, or the third value of a ``GPS`` tuple with letters, if it has a unit. The
        third value of other tuples counts satellites, or has no known datum.
        """
        height = self.read_first(caption, _ABS_ALTS)
        parts = split_tuple(caption.tuples.get("gps", ""))
        if height is not None or len(parts) != 3 or not split_letter(parts[0])[0]:
            return height
        return self._metres(parts[2]) if parse_quantity(parts[2], self.marks)[1] else None

    def list_unknown(self, caption: Caption) -> list[str]:
        """Return a phrase for each height of a subtitle that cannot be read."""
        return [
            f"height {name} {caption.fields[name][:40]} is unknown"
            for name in (*_REL_ALTS, *_ABS_ALTS)
            if name in caption.fields and self._metres(caption.fields[name]) is None
        ]

    def _metres(self, text: str) -> float | None:
        number, unit = parse_quantity(text, self.marks)
        metres = metres_per(unit) if unit else 1.0 if self.unitless_is_metres else None
        if number is None or metres is None or abs(number * metres) >= _MAX_HEIGHT_M:
            return None
        return number * metres


def _parse_attitudes(
    captions: Sequence[Caption], marks: DecimalMarks
) -> tuple[list[tuple[float, float, float] | None], str]:
    """Return yaw, pitch and roll of each subtitle, and the reason why some are rejected.

    An attitude is None where one of its angles is unknown. Where all angles are whole numbers and
    some are out of range, the unit is not degrees and all are rejected.
    """
    attitudes = [_parse_gimbal(caption, marks) for caption in captions]
    known = [angles for angles in attitudes if angles is not None]
    wrong = [angles for angles in known if not _is_in_range(angles)]
    if not wrong:
        return attitudes, ""
    whole = all(value.is_integer() for angles in known for value in angles)
    yaw, pitch, roll = wrong[0]
    return (
        [None if whole or a is None or not _is_in_range(a) else a for a in attitudes],
        f"the gimbal's yaw {yaw:g}, pitch {pitch:g}, roll {roll:g} are out of range",
    )


def _is_in_range(angles: tuple[float, float, float]) -> bool:
    return all(abs(angle) <= limit for angle, limit in zip(angles, LARGEST_ANGLES, strict=True))


def _parse_gimbal(caption: Caption, marks: DecimalMarks) -> tuple[float, float, float] | None:
    if any(name in caption.fields for name in _GIMBAL):
        yaw, pitch, roll = (parse_angle(caption.fields.get(name), marks) for name in _GIMBAL)
    elif len(parts := split_tuple(caption.tuples.get("g.pry", ""))) == 3:
        pitch, roll, yaw = (parse_angle(part, marks) for part in parts)
    else:
        return None
    return None if yaw is None or pitch is None or roll is None else (yaw, pitch, roll)


def _parse_frame(fields: Mapping[str, str]) -> int | None:
    text = fields.get("framecnt", "").strip()
    return int(text) if text.isdecimal() and len(text) < 10 else None


def _parse_time(text: str) -> datetime | None:
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
            # Convert a time with a zone to UTC.
            time -= int(f"{zone[0]}1") * timedelta(hours=int(zone[1:3]), minutes=int(zone[-2:]))
        return time
    except (ValueError, OverflowError):
        return None
