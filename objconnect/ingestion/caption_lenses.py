"""Parse focal lengths and digital zoom from a drone's subtitles."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

from objconnect.ingestion.captions import Caption, parse_quantity
from objconnect.scene.quantities.decimal_marks import DecimalMarks
from objconnect.scene.quantities.film_lens import (
    millimetres_per_unit,
    plausible_focal,
    scales_whole_numbers,
    zoom_ratio,
)
from objconnect.scene.quantities.reading import Reading, known, unknown

ZOOMS: Final = ("dzoom_ratio", "dzoom")
"""Field names of the digital zoom."""
_FOCAL: Final = "focal_len"
_APERTURES: Final = ("fnum", "f-num")


@dataclass(frozen=True)
class Lenses:
    """Focal lengths and digital zoom in the subtitles of a file.

    Attributes:
        focals: 35 mm equivalent focal length of each subtitle without digital zoom, mm; None where
            unknown.
        zooms: Digital zoom of each subtitle, a ratio; 1 where the file has none, None where
            unknown.
        doubts: Reasons why values are unknown, and notes on how values were decided, a phrase each;
            three at most.
        doubts_of: The same reasons and notes for each subtitle.
    """

    focals: Sequence[float | None]
    zooms: Sequence[float | None]
    doubts: tuple[str, ...]
    doubts_of: Sequence[tuple[str, ...]]


def parse_lenses(
    captions: Sequence[Caption], marks: DecimalMarks, map_focals: Collection[float]
) -> Lenses:
    """Parse focal lengths and digital zoom in a file's subtitles.

    A subtitle without a value takes the value of the other subtitles if they all agree.

    Args:
        captions: Subtitles sorted by time.
        marks: Decimal marks of the file.
        map_focals: 35 mm equivalent focal lengths of the map's cameras, mm.
    """
    focals = _parse_focals(captions, marks, map_focals)
    zooms = _parse_zooms(captions, marks)
    doubts_of = [
        tuple(doubt for reading in pair if reading is not None for doubt in reading.doubts)
        for pair in zip(focals, zooms, strict=True)
    ]
    doubts = dict.fromkeys(doubt for each in doubts_of for doubt in each)
    if all(zoom is None for zoom in zooms):
        zooms = [known(1.0, ZOOMS[0])] * len(captions)
    return Lenses(_fill_gaps(focals), _fill_gaps(zooms), tuple(doubts)[:3], doubts_of)


def _fill_gaps(readings: Sequence[Reading[float] | None]) -> list[float | None]:
    """Return values, with missing ones taken from the others if these are all equal."""
    values = {reading.value for reading in readings if reading is not None}
    same = values.pop() if len(values) == 1 else None
    return [same if reading is None else reading.value for reading in readings]


def _parse_focals(
    captions: Sequence[Caption], marks: DecimalMarks, map_focals: Collection[float]
) -> list[Reading[float] | None]:
    texts = [caption.fields.get(_FOCAL) for caption in captions]
    numbers = [None if text is None else _parse_millimetres(text, marks) for text in texts]
    valid = [
        (str(text), number)
        for text, number in zip(texts, numbers, strict=True)
        # Cameras write zero for an unknown focal length.
        if number is not None and number > 0
    ]
    if not valid:
        return [_unparsable(text) for text in texts]
    apertures = {
        caption.fields[name]
        for caption in captions
        for name in _APERTURES
        if name in caption.fields
    }
    written, values = zip(*valid, strict=True)
    unit = known(1.0, _FOCAL)
    if not any("mm" in text for text in written):
        scaled = scales_whole_numbers(apertures, _writes_ten_thousandths(captions))
        unit = millimetres_per_unit(written, values, scaled, map_focals)
    readings: list[Reading[float] | None] = []
    for text, number in zip(texts, numbers, strict=True):
        if text is None or number is None or number <= 0:
            readings.append(_unparsable(text))
            continue
        millimetres = None if unit.value is None else plausible_focal(unit.value * number)
        doubts = unit.doubts
        if unit.is_known and millimetres is None:
            doubts = (*doubts, f"{_FOCAL} {text} is not a 35 mm equivalent focal length")
        readings.append(Reading(millimetres, _FOCAL, doubts))
    return readings


def _unparsable(text: str | None) -> Reading[float] | None:
    return None if text is None else unknown(_FOCAL, f"{_FOCAL} {text[:40]} is not understood")


def _parse_millimetres(text: str, marks: DecimalMarks) -> float | None:
    number, unit = parse_quantity(text, marks)
    return number if unit in ("", "mm") else None


def _writes_ten_thousandths(captions: Sequence[Caption]) -> bool:
    """Return whether zooms are written in ten-thousandths, as ``20000, delta:0``."""
    return any(
        "delta" in caption.fields and caption.fields[name].strip().isdecimal()
        for caption in captions
        for name in ZOOMS
        if name in caption.fields
    )


def _parse_zooms(captions: Sequence[Caption], marks: DecimalMarks) -> list[Reading[float] | None]:
    in_ten_thousandths = _writes_ten_thousandths(captions)
    zooms: list[Reading[float] | None] = []
    for caption in captions:
        readings = {
            name: _parse_zoom(name, text, marks, in_ten_thousandths)
            for name, text in caption.fields.items()
            if "zoom" in name
        }
        unknown_ones = [reading for reading in readings.values() if not reading.is_known]
        known_ones = [reading for name, reading in readings.items() if name in ZOOMS]
        zooms.append(next(iter((*unknown_ones, *known_ones)), None))
    return zooms


def _parse_zoom(
    name: str, text: str, marks: DecimalMarks, in_ten_thousandths: bool
) -> Reading[float]:
    number, unit = parse_quantity(text, marks)
    if number is None or unit not in ("", "x", "X"):
        return unknown(name, f"{name} {text[:40]} is not understood")
    reading = zoom_ratio(text.rstrip("xX "), number, in_ten_thousandths, name)
    if name not in ZOOMS and reading.value != 1:
        return unknown(name, f"{name} {text[:40]} is not understood")
    return reading
