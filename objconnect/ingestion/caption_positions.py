"""Parse positions from a drone's subtitles.

Field names or letters distinguish latitude from longitude; otherwise plausibility checks decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from objconnect.ingestion.captions import (
    Caption,
    parse_angle,
    parse_quantity,
    split_letter,
    split_tuple,
)
from objconnect.scene.quantities.angles import LATITUDE, LONGITUDE, Axis, parse_coordinate
from objconnect.scene.quantities.coordinate_order import (
    Order,
    Pair,
    PairedTrack,
    drop_jumps,
    infer_order,
    to_lat_lon,
)
from objconnect.scene.quantities.decimal_marks import DecimalMarks

LATITUDES: Final = ("latitude", "lat")
"""Field names of the latitude."""
LONGITUDES: Final = ("longitude", "longtitude", "lon", "lng", "long")
"""Field names of the longitude; one drone misspells it."""
# Names of tuples with a position, the more accurate first.
_PAIRS: Final = ("rtk", "gps")
_SIGNS: Final = {"N": 1.0, "E": 1.0, "S": -1.0, "W": -1.0}
_MAX_LONGITUDE: Final = 180.0


@dataclass(frozen=True)
class Positions:
    """Positions of the subtitles of a file.

    Attributes:
        values: Latitude and longitude of each subtitle, degrees; None where unknown.
        doubts: Reasons why positions are unknown or dropped, a phrase each; three at most.
        doubt_of: Reason why the position of a subtitle is unknown or dropped, by row.
    """

    values: Sequence[Pair | None]
    doubts: tuple[str, ...]
    doubt_of: Mapping[int, str]


@dataclass(frozen=True)
class _Fix:
    """The position of a subtitle: latitude and longitude, or two numbers of unknown order."""

    lat_lon: Pair | None = None
    pair: Pair | None = None
    doubt: str = ""


def parse_positions(
    captions: Sequence[Caption], marks: DecimalMarks, near: Pair | None
) -> Positions:
    """Parse the positions of a file's subtitles.

    Latitude 0 with longitude 0 means no fix. Positions that a drone cannot have reached from those
    before and after are dropped.

    Args:
        captions: The parsed subtitles, sorted by time.
        marks: Decimal marks of the file.
        near: Latitude and longitude of the map, degrees; None where unknown.
    """
    seconds = [caption.subtitle.start_s for caption in captions]
    fixes = [_parse_fix(caption, marks) for caption in captions]
    doubt_of = {row: fix.doubt for row, fix in enumerate(fixes) if fix.doubt}
    doubts = dict.fromkeys(doubt_of.values())
    rows = [row for row, fix in enumerate(fixes) if fix.pair is not None]
    positions = [fix.lat_lon for fix in fixes]
    if rows:
        order = infer_order(_gather_pairs(captions, fixes, rows, marks), near)
        doubts |= dict.fromkeys(order.doubts)
        doubt_of |= dict.fromkeys(rows if order.doubts else (), order.why)
        for row in rows:
            pair = fixes[row].pair
            if order.value is not None and pair is not None:
                positions[row] = to_lat_lon(pair, order.value)
    values = drop_jumps(seconds, positions)
    jumps = [row for row, fix in enumerate(positions) if fix is not None and values[row] is None]
    doubt_of |= dict.fromkeys(jumps, "its position is out of a drone's reach")
    if jumps:
        doubts[f"{len(jumps)} positions jump out of a drone's reach, and are left out"] = None
    return Positions(values, tuple(doubts)[:3], doubt_of)


def _parse_fix(caption: Caption, marks: DecimalMarks) -> _Fix:
    fields = caption.fields
    latitude = next((fields[name] for name in LATITUDES if name in fields), None)
    longitude = next((fields[name] for name in LONGITUDES if name in fields), None)
    if latitude is not None and longitude is not None:
        return _parse_named_fix(latitude, longitude, marks)
    name = next((name for name in _PAIRS if name in caption.tuples), None)
    if name is not None:
        return _parse_paired_fix(name, caption.tuples[name], marks)
    bare = next((name for name in _PAIRS if name in fields), None)
    return (
        _Fix() if bare is None else _Fix(doubt=_describe_unknown(bare.upper(), fields[bare], marks))
    )


def _parse_named_fix(latitude: str, longitude: str, marks: DecimalMarks) -> _Fix:
    coordinates = tuple(
        _parse_spelled(text, axis)
        if (number := _parse_coordinate(text, letters, marks)) is None
        else number
        for text, letters, axis in ((latitude, "NS", LATITUDE), (longitude, "EW", LONGITUDE))
    )
    for name, text, number in zip(
        ("latitude", "longitude"), (latitude, longitude), coordinates, strict=True
    ):
        if number is None:
            return _Fix(doubt=_describe_unknown(name, text, marks))
    lat_lon = _check_position(*coordinates)
    if lat_lon is None and any(coordinates):
        return _Fix(doubt=f"latitude {latitude[:40]}, longitude {longitude[:40]} is not on earth")
    return _Fix(lat_lon)


def _parse_spelled(text: str, axis: Axis) -> float | None:
    """Return a coordinate with a word for its direction, or with minutes and seconds."""
    # A comma separates numbers in some spellings and is a decimal mark in others.
    return None if "," in text else parse_coordinate(text, axis, axis.tag, signed=True).value


def _parse_coordinate(text: str, letters: str, marks: DecimalMarks) -> float | None:
    """Return a coordinate with its sign; None where letter or number cannot be parsed."""
    letter, rest = split_letter(text)
    number = parse_angle(rest, marks)
    if number is None or not letter:
        return number
    # A letter with a negative sign is ambiguous.
    return _SIGNS[letter] * number if letter in letters and number >= 0 else None


def _parse_paired_fix(name: str, inner: str, marks: DecimalMarks) -> _Fix:
    doubt = _describe_unknown(name.upper(), f"({inner})", marks)
    parts = split_tuple(inner)
    if not 2 <= len(parts) <= 3:
        return _Fix(doubt=doubt)
    letters = [split_letter(part)[0] for part in parts[:2]]
    kinds = ["".join(kind for kind in ("NS", "EW") if letter in kind) for letter in letters]
    if letters == ["", ""]:
        first, second = (parse_angle(part, marks) for part in parts[:2])
        if first is None or second is None:
            return _Fix(doubt=doubt)
        if first == second == 0 or max(abs(first), abs(second)) > _MAX_LONGITUDE:
            return _Fix()
        return _Fix(pair=(first, second))
    if "" in letters or set(kinds) != {"NS", "EW"}:
        return _Fix(doubt=doubt)
    first, second = (
        _parse_coordinate(part, kind, marks) for part, kind in zip(parts, kinds, strict=False)
    )
    if first is None or second is None:
        return _Fix(doubt=doubt)
    order: Order = "latitude" if kinds[0] == "NS" else "longitude"
    return _Fix(_check_position(*to_lat_lon((first, second), order)))


def _describe_unknown(name: str, text: str, marks: DecimalMarks) -> str:
    why = f": {marks.doubt}" if marks.doubt else ""
    return f"{name} {text[:40]} is not understood{why}"


def _check_position(latitude: float | None, longitude: float | None) -> Pair | None:
    """Return the coordinates; None where one is missing or out of range, or both are 0."""
    if latitude is None or longitude is None:
        return None
    if abs(latitude) > 90 or abs(longitude) > _MAX_LONGITUDE:
        return None
    return None if latitude == longitude == 0 else (latitude, longitude)


def _gather_pairs(
    captions: Sequence[Caption], fixes: Sequence[_Fix], rows: Sequence[int], marks: DecimalMarks
) -> PairedTrack:
    """Gather the values of the subtitles that decide the order of their pairs."""
    homes = {
        _parse_paired_fix("home", captions[row].tuples["home"], marks): None
        for row in rows
        if "home" in captions[row].tuples
    }
    distances, speeds = [], []
    for at, row in enumerate(rows):
        distance = _read_in_unit(captions[row].fields, "d", "m", marks)
        speed = _read_in_unit(captions[row].fields, "h.s", "m/s", marks)
        distances += [] if distance is None else [(at, distance)]
        speeds += [] if speed is None else [speed]
    return PairedTrack(
        seconds=[captions[row].subtitle.start_s for row in rows],
        pairs=[pair for row in rows if (pair := fixes[row].pair) is not None],
        home_pairs=[home.pair for home in homes if home.pair is not None],
        home_lat_lons=[home.lat_lon for home in homes if home.lat_lon is not None],
        distances=distances,
        speeds=speeds if len(speeds) == len(rows) else (),
    )


def _read_in_unit(
    fields: Mapping[str, str], name: str, unit: str, marks: DecimalMarks
) -> float | None:
    number, written = parse_quantity(fields.get(name), marks)
    return number if number is not None and written == unit and number >= 0 else None
