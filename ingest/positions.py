"""Where photographs were taken: by their EXIF, or by a table."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from ingest.photographs import Roll, Shot
from scene.errors import InputError
from scene.files import read_text
from scene.geodesy import Geodetic, enu_from_geodetic

FEWEST = 3
_COLUMNS = ("name", "lat", "lon", "alt")


def with_positions(roll: Roll, table: Path) -> Roll:
    """The roll with the positions of a table instead of those in EXIF.

    Args:
        roll: photographs.
        table: CSV with a header; columns ``name`` (of the file, or its path in the folder), ``lat``
            and ``lon`` in degrees and ``alt`` in metres. Others do not count, nor do photographs
            that are not in the roll.

    Raises:
        InputError: it cannot be read, lacks a column, has a bad number or a name twice, or has none
            of the photographs.
    """
    places = _read(table)
    shots = [
        replace(shot, exif=replace(shot.exif, position=places.get(shot.file, places.get(name))))
        for shot in roll.shots
        for name in [PurePosixPath(shot.file).name]
    ]
    if places and not any(shot.exif.position for shot in shots):
        raise InputError(
            f"{table} has none of the photographs: its first name is {next(iter(places))!r}, that "
            f"of the first photograph {roll.shots[0].file!r}"
        )
    return replace(roll, shots=tuple(shots))


def _read(table: Path) -> dict[str, Geodetic]:
    reader = csv.DictReader(read_text(table, "table of positions").lstrip("\ufeff").splitlines())
    missing = [column for column in _COLUMNS if column not in (reader.fieldnames or ())]
    if missing:
        raise InputError(
            f"{table} has no column {missing[0]}: its first line must name {','.join(_COLUMNS)}"
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
    # Of each coordinate, so that a few wrong ones do not count.
    origin = Geodetic(*np.median(np.array(list(known.values())), axis=0).tolist())
    return origin, {name: enu_from_geodetic(place, origin) for name, place in known.items()}
