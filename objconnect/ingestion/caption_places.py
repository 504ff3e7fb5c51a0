"""Positions that subtitles tell, by the names of their fields, by letters, or by checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from objconnect.ingestion.captions import Caption, angle, parts_of, quantity, split_letter
from objconnect.scene.quantities.angles import LATITUDE, LONGITUDE, Axis, parse_coordinate
from objconnect.scene.quantities.coordinate_order import (
    Order,
    Pair,
    PairedTrack,
    infer_order,
    to_lat_lon,
    without_jumps,
)
from objconnect.scene.quantities.decimal_marks import DecimalMarks

LATITUDES: Final = ("latitude", "lat")
"""Names of the field of a latitude."""
LONGITUDES: Final = ("longitude", "longtitude", "lon", "lng", "long")
"""Names of the field of a longitude; a drone misspells it."""
# The better fix comes first.
_PAIRS: Final = ("rtk", "gps")
_SIGNS: Final = {"N": 1.0, "E": 1.0, "S": -1.0, "W": -1.0}
_LARGEST: Final = 180.0


@dataclass(frozen=True)
class Places:
    """Positions of the subtitles of a file.

    Attributes:
        places: Latitude and longitude of each subtitle, degrees; None where it is not known.
        doubts: Why positions are unknown or left out, a phrase each.
        of_each: Why the position of a subtitle is unknown or left out, by its row.
    """

    places: Sequence[Pair | None]
    doubts: tuple[str, ...]
    of_each: Mapping[int, str]


@dataclass(frozen=True)
class _Fix:
    """Two numbers of a subtitle: a place, or a pair whose order is not written."""

    place: Pair | None = None
    pair: Pair | None = None
    doubt: str = ""


def places_of(captions: Sequence[Caption], marks: DecimalMarks, near: Pair | None) -> Places:
    """Return the positions of a file's subtitles.

    Latitude 0 and longitude 0 together mean that there was no fix. A place to which no drone can
    have flown from those before and after is left out.

    Args:
        captions: Subtitles in the order of their times.
        marks: Decimal marks of the file.
        near: Latitude and longitude of the map, degrees; None where that is not known.
    """
    seconds = [caption.subtitle.start_s for caption in captions]
    fixes = [_fix_of(caption, marks) for caption in captions]
    of_each = {row: fix.doubt for row, fix in enumerate(fixes) if fix.doubt}
    doubts = dict.fromkeys(of_each.values())
    rows = [row for row, fix in enumerate(fixes) if fix.pair is not None]
    places = [fix.place for fix in fixes]
    if rows:
        order = infer_order(_track(captions, fixes, rows, marks), near)
        doubts |= dict.fromkeys(order.doubts)
        of_each |= dict.fromkeys(rows if order.doubts else (), order.why)
        for row in rows:
            pair = fixes[row].pair
            if order.value is not None and pair is not None:
                places[row] = to_lat_lon(pair, order.value)
    kept = without_jumps(seconds, places)
    lost = [row for row, place in enumerate(places) if place is not None and kept[row] is None]
    of_each |= dict.fromkeys(lost, "its position is where no drone can have flown")
    if lost:
        jumps = f"{len(lost)} positions jump to where no drone can have flown, and are left out"
        doubts[jumps] = None
    # One phrase of a kind is enough for a person.
    return Places(kept, tuple(doubts)[:3], of_each)


def _fix_of(caption: Caption, marks: DecimalMarks) -> _Fix:
    fields = caption.fields
    latitude = next((fields[name] for name in LATITUDES if name in fields), None)
    longitude = next((fields[name] for name in LONGITUDES if name in fields), None)
    if latitude is not None and longitude is not None:
        return _fix_by_names(latitude, longitude, marks)
    name = next((name for name in _PAIRS if name in caption.tuples), None)
    if name is not None:
        return _fix_by_pair(name, caption.tuples[name], marks)
    bare = next((name for name in _PAIRS if name in fields), None)
    return (
        _Fix() if bare is None else _Fix(doubt=_describe_unknown(bare.upper(), fields[bare], marks))
    )


def _fix_by_names(latitude: str, longitude: str, marks: DecimalMarks) -> _Fix:
    place = tuple(
        _parse_coordinate(text, axis)
        if (number := _coordinate(text, letters, marks)) is None
        else number
        for text, letters, axis in ((latitude, "NS", LATITUDE), (longitude, "EW", LONGITUDE))
    )
    for name, text, number in zip(
        ("latitude", "longitude"), (latitude, longitude), place, strict=True
    ):
        if number is None:
            return _Fix(doubt=_describe_unknown(name, text, marks))
    here = _on_earth(place[0], place[1])
    if here is None and any(place):
        return _Fix(doubt=f"latitude {latitude[:40]}, longitude {longitude[:40]} is not on earth")
    return _Fix(place=here)


def _parse_coordinate(text: str, axis: Axis) -> float | None:
    """Return a coordinate with a word for its direction, or with minutes and seconds."""
    # A comma divides numbers in some spellings and is a decimal mark in others.
    return None if "," in text else parse_coordinate(text, axis, axis.tag, signed=True).value


def _coordinate(text: str, letters: str, marks: DecimalMarks) -> float | None:
    """Return a coordinate with its sign; None where letter or number are not understood."""
    letter, rest = split_letter(text)
    number = angle(rest, marks)
    if number is None or not letter:
        return number
    # A letter and a sign would tell the direction twice.
    return _SIGNS[letter] * number if letter in letters and number >= 0 else None


def _fix_by_pair(name: str, inner: str, marks: DecimalMarks) -> _Fix:
    doubt = _describe_unknown(name.upper(), f"({inner})", marks)
    parts = parts_of(inner)
    if not 2 <= len(parts) <= 3:
        return _Fix(doubt=doubt)
    letters = [split_letter(part)[0] for part in parts[:2]]
    kinds = ["".join(kind for kind in ("NS", "EW") if letter in kind) for letter in letters]
    if letters == ["", ""]:
        first, second = (angle(part, marks) for part in parts[:2])
        if first is None or second is None:
            return _Fix(doubt=doubt)
        if first == second == 0 or max(abs(first), abs(second)) > _LARGEST:
            return _Fix()
        return _Fix(pair=(first, second))
    if "" in letters or set(kinds) != {"NS", "EW"}:
        return _Fix(doubt=doubt)
    first, second = (
        _coordinate(part, kind, marks) for part, kind in zip(parts, kinds, strict=False)
    )
    if first is None or second is None:
        return _Fix(doubt=doubt)
    return _Fix(place=_on_earth(*to_lat_lon((first, second), _first_is(kinds[0]))))


def _first_is(kind: str) -> Order:
    return "latitude" if kind == "NS" else "longitude"


def _describe_unknown(name: str, text: str, marks: DecimalMarks) -> str:
    why = f": {marks.doubt}" if marks.doubt else ""
    return f"{name} {text[:40]} is not understood{why}"


def _on_earth(latitude: float | None, longitude: float | None) -> Pair | None:
    if latitude is None or longitude is None or abs(latitude) > 90 or abs(longitude) > _LARGEST:
        return None
    return None if latitude == longitude == 0 else (latitude, longitude)


def _track(
    captions: Sequence[Caption], fixes: Sequence[_Fix], rows: Sequence[int], marks: DecimalMarks
) -> PairedTrack:
    """Return what the subtitles tell of the order of their pairs."""
    homes = {
        _fix_by_pair("home", captions[row].tuples["home"], marks): None
        for row in rows
        if "home" in captions[row].tuples
    }
    distances, speeds = [], []
    for at, row in enumerate(rows):
        distance = _read_metres(captions[row].fields, "d", "m", marks)
        speed = _read_metres(captions[row].fields, "h.s", "m/s", marks)
        distances += [] if distance is None else [(at, distance)]
        speeds += [] if speed is None else [speed]
    return PairedTrack(
        seconds=[captions[row].subtitle.start_s for row in rows],
        pairs=[pair for row in rows if (pair := fixes[row].pair) is not None],
        homes=[home.pair for home in homes if home.pair is not None],
        home_places=[home.place for home in homes if home.place is not None],
        distances=distances,
        speeds=speeds if len(speeds) == len(rows) else (),
    )


def _read_metres(
    fields: Mapping[str, str], name: str, unit: str, marks: DecimalMarks
) -> float | None:
    number, written = quantity(fields.get(name), marks)
    return number if number is not None and written == unit and number >= 0 else None
