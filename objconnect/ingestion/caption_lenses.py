"""Focal lengths and digital zoom that subtitles tell."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

from objconnect.ingestion.captions import Caption, quantity
from objconnect.scene.quantities.decimal_marks import DecimalMarks
from objconnect.scene.quantities.film_lens import (
    focal_on_film,
    millimetres_per_unit,
    scales_whole_numbers,
    zoom_ratio,
)
from objconnect.scene.quantities.reading import Reading, known, unknown

ZOOMS: Final = ("dzoom_ratio", "dzoom")
"""Names of the field of a digital zoom."""
_FOCAL: Final = "focal_len"
_APERTURES: Final = ("fnum", "f-num")


@dataclass(frozen=True)
class Lenses:
    """Lenses of the subtitles of a file.

    Attributes:
        focals: Focal length of each subtitle on 35 mm film without digital zoom, mm; None where it
            is not known.
        zooms: Digital zoom of each subtitle, a ratio; 1 where the file tells of none, None where it
            is not known.
        doubts: Why some are unknown, a phrase each.
        of_each: Why those of each subtitle are unknown, or how they were told.
    """

    focals: Sequence[float | None]
    zooms: Sequence[float | None]
    doubts: tuple[str, ...]
    of_each: Sequence[tuple[str, ...]]


def lenses_of(
    captions: Sequence[Caption], marks: DecimalMarks, lenses: Collection[float]
) -> Lenses:
    """Return the lenses of a file's subtitles.

    A subtitle that does not tell has the value of the others, if they all tell the same one.

    Args:
        captions: Subtitles in the order of their times.
        marks: Decimal marks of the file.
        lenses: Focal lengths of the map's cameras on 35 mm film, mm.
    """
    focals = _focals(captions, marks, lenses)
    zooms = _zooms(captions, marks)
    of_each = [
        tuple(doubt for reading in pair if reading is not None for doubt in reading.doubts)
        for pair in zip(focals, zooms, strict=True)
    ]
    doubts = dict.fromkeys(doubt for each in of_each for doubt in each)
    if all(zoom is None for zoom in zooms):
        zooms = [known(1.0, ZOOMS[0])] * len(captions)
    return Lenses(_fill_gaps(focals), _fill_gaps(zooms), tuple(doubts)[:3], of_each)


def _fill_gaps(readings: Sequence[Reading[float] | None]) -> list[float | None]:
    """Return values; where a subtitle says nothing, the one that all others have."""
    values = {reading.value for reading in readings if reading is not None}
    same = values.pop() if len(values) == 1 else None
    return [same if reading is None else reading.value for reading in readings]


def _focals(
    captions: Sequence[Caption], marks: DecimalMarks, lenses: Collection[float]
) -> list[Reading[float] | None]:
    texts = [caption.fields.get(_FOCAL) for caption in captions]
    read = [None if text is None else _millimetres(text, marks) for text in texts]
    understood = [
        (str(text), number)
        for text, number in zip(texts, read, strict=True)
        # Zero is no focal length: the camera did not tell.
        if number is not None and number > 0
    ]
    if not understood:
        return [_unread(text) for text in texts]
    apertures = {
        caption.fields[name]
        for caption in captions
        for name in _APERTURES
        if name in caption.fields
    }
    written, numbers = zip(*understood, strict=True)
    unit = known(1.0, _FOCAL)
    if not any("mm" in text for text in written):
        scaled = scales_whole_numbers(apertures, _writes_ten_thousandths(captions))
        unit = millimetres_per_unit(written, numbers, scaled, lenses)
    found: list[Reading[float] | None] = []
    for text, number in zip(texts, read, strict=True):
        if text is None or number is None or number <= 0:
            found.append(_unread(text))
            continue
        millimetres = None if unit.value is None else focal_on_film(unit.value * number)
        doubts = unit.doubts
        if unit.is_known and millimetres is None:
            doubts = (*doubts, f"{_FOCAL} {text} is no focal length on 35 mm film")
        found.append(Reading(millimetres, _FOCAL, doubts))
    return found


def _unread(text: str | None) -> Reading[float] | None:
    return None if text is None else unknown(_FOCAL, f"{_FOCAL} {text[:40]} is not understood")


def _millimetres(text: str, marks: DecimalMarks) -> float | None:
    number, unit = quantity(text, marks)
    return number if unit in ("", "mm") else None


def _writes_ten_thousandths(captions: Sequence[Caption]) -> bool:
    """Return whether zooms are written as ``20000, delta:0``."""
    return any(
        "delta" in caption.fields and caption.fields[name].strip().isdecimal()
        for caption in captions
        for name in ZOOMS
        if name in caption.fields
    )


def _zooms(captions: Sequence[Caption], marks: DecimalMarks) -> list[Reading[float] | None]:
    in_ten_thousandths = _writes_ten_thousandths(captions)
    found: list[Reading[float] | None] = []
    for caption in captions:
        names = [name for name in caption.fields if "zoom" in name]
        readings = [_zoom(name, caption.fields[name], marks, in_ten_thousandths) for name in names]
        bad = [reading for reading in readings if not reading.is_known]
        told = [reading for name, reading in zip(names, readings, strict=True) if name in ZOOMS]
        found.append(bad[0] if bad else told[0] if told else None)
    return found


def _zoom(name: str, text: str, marks: DecimalMarks, in_ten_thousandths: bool) -> Reading[float]:
    number, unit = quantity(text, marks)
    if number is None or unit not in ("", "x", "X"):
        return unknown(name, f"{name} {text[:40]} is not understood")
    reading = zoom_ratio(text.rstrip("xX "), number, in_ten_thousandths, name)
    if name not in ZOOMS and reading.value != 1:
        return unknown(name, f"{name} {text[:40]} is not understood")
    return reading
