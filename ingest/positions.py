"""Where photographs were taken: by their EXIF, or by a table."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from ingest.photographs import Roll, Shot
from scene.errors import InputError
from scene.geometry.geodesy import Geodetic, enu_from_geodetic, median_place
from scene.storage.files import read_text

FEWEST = 3
_COLUMNS = ("name", "lat", "lon", "alt")


def with_positions(roll: Roll, table: Path) -> Roll:
    """The roll with the positions of a table instead of those in EXIF.

    Args:
        roll: photographs.
        table: CSV with a header; columns ``name`` (of the file, or its path in the folder), ``lat``
            and ``lon`` in degrees and ``alt`` in metres. Others do not count, nor do photographs
            that are not in the roll. Upper and lower case, and ``\\`` and ``/``, are the same where
            no other photograph has the very name.

    Raises:
        InputError: it cannot be read, lacks a column or has one twice, has a bad number or a name
            twice, a name without a folder that several photographs have, or none of the
            photographs.
    """
    places = _read(table)
    rows = _rows([shot.file for shot in roll.shots], list(places), table)
    shots = [
        replace(
            shot,
            exif=replace(
                shot.exif, position=places[rows[shot.file]] if shot.file in rows else None
            ),
        )
        for shot in roll.shots
    ]
    if places and not any(shot.exif.position for shot in shots):
        raise InputError(
            f"{table} has none of the photographs: its first name is {next(iter(places))!r}, that "
            f"of the first photograph {roll.shots[0].file!r}"
        )
    return replace(roll, shots=tuple(shots))


def _rows(files: Sequence[str], names: Sequence[str], table: Path) -> dict[str, str]:
    """The name in the table of each file that has one."""
    known = set(names)
    loose: dict[str, list[str]] = {}
    for name in names:
        loose.setdefault(_folded(name), []).append(name)
    rows: dict[str, str] = {}
    owners: dict[str, str] = {}
    for file in files:
        spellings = (file, PurePosixPath(file).name)
        found = [name for name in spellings if name in known]
        for alike in (loose.get(_folded(spelling), []) for spelling in spellings):
            found += alike if len(alike) == 1 else []
        if not found:
            continue
        other = owners.setdefault(found[0], file)
        if other != file:
            raise InputError(
                f"{table}: {found[0]!r} may be {other!r} or {file!r}: give names with their folder"
            )
        rows[file] = found[0]
    return rows


def _folded(name: str) -> str:
    return name.replace("\\", "/").casefold()


def _read(table: Path) -> dict[str, Geodetic]:
    text = read_text(table, "table of positions").lstrip("\ufeff")
    reader = csv.DictReader(io.StringIO(text, newline=""))
    try:
        return _parsed(reader, table)
    except csv.Error as error:
        raise InputError(
            f"{table}, line {reader.line_num}: {error}: is there a stray quote?"
        ) from None


def _parsed(reader: csv.DictReader[str], table: Path) -> dict[str, Geodetic]:
    header = list(reader.fieldnames or ())
    for column in _COLUMNS:
        if header.count(column) != 1:
            wrong = "no column" if column not in header else "two columns"
            raise InputError(
                f"{table} has {wrong} {column}: its first line must name {','.join(_COLUMNS)}"
            )
    places: dict[str, Geodetic] = {}
    for row in reader:
        try:
            place = Geodetic(*(float(row[column]) for column in _COLUMNS[1:]))
        except (TypeError, ValueError):
            place = Geodetic(math.nan, math.nan, math.nan)
        if not (abs(place.latitude) <= 90 and abs(place.longitude) <= 180) or not math.isfinite(
            place.altitude
        ):
            raise InputError(
                f"{table}, line {reader.line_num}: lat, lon and alt must be degrees and metres"
            )
        if row["name"] in places:
            raise InputError(f"{table}, line {reader.line_num}: {row['name']} is there twice")
        places[row["name"]] = place
    return places


def local(shots: Sequence[Shot]) -> tuple[Geodetic, dict[str, NDArray[np.float64]]]:
    """An origin amid the photographs, and positions (3,) from there, metres east, north and up.

    Raises:
        InputError: fewer than three photographs have one.
    """
    known: Mapping[str, Geodetic] = {
        shot.name: shot.exif.position for shot in shots if shot.exif.position is not None
    }
    if len(known) < FEWEST:
        raise InputError(
            f"{len(known)} of {len(shots)} photographs have a GPS position, {FEWEST} are needed, "
            "for a scene has metres and a place on earth: give --gps CSV with columns "
            f"{','.join(_COLUMNS)}"
        )
    origin = median_place(list(known.values()))
    return origin, {name: enu_from_geodetic(place, origin) for name, place in known.items()}
