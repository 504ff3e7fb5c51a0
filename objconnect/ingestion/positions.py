"""Positions of photographs, from EXIF or from a table."""

from __future__ import annotations

import csv
import io
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.photographs import Flight, FlightImage
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic, median_place
from objconnect.scene.imports.names import match_files
from objconnect.scene.storage.files import read_text
from objconnect.scene.storage.tables import require_commas

log = logging.getLogger(__name__)

MIN_PHOTOGRAPHS = 3
"""Minimum number of photographs of a scene."""
# Positions of a receiver that is stuck are nearer to their median than this, metres.
_EQUAL_M = 0.01
_COLUMNS = ("name", "lat", "lon", "alt")


def replace_positions(flight: Flight, table: Path) -> Flight:
    """Return the flight with the positions of a table instead of those in EXIF.

    Args:
        flight: The photographs.
        table: CSV file with a header. The column ``name`` is the name of a file, or its path in
            the folder; ``lat`` and ``lon`` are degrees, ``alt`` is metres. Other columns, and rows
            of photographs that are not in the flight, are ignored. ``match_files`` compares names.

    Raises:
        InputError: The table cannot be read, lacks or repeats a column, has a bad number or repeats
            a name, has a name without a folder that several photographs share, or names none of the
            photographs.
    """
    places = _read(table)
    rows = match_files([image.file for image in flight.images], list(places), table)
    images = [
        replace(
            image,
            exif=replace(
                image.exif,
                position=places[rows[image.file]] if image.file in rows else None,
                place_doubts=(),
            ),
        )
        for image in flight.images
    ]
    if places and not any(image.exif.position for image in images):
        raise InputError(
            f"{table} names none of the photographs: its first name is {next(iter(places))!r}, the "
            f"first photograph is {flight.images[0].file!r}"
        )
    return replace(flight, images=tuple(images))


def _read(table: Path) -> dict[str, Geodetic]:
    text = read_text(table, "table of positions").lstrip("\ufeff")
    reader = csv.DictReader(io.StringIO(text, newline=""))
    try:
        return _parse_table(reader, table)
    except csv.Error as error:
        raise InputError(
            f"{table}, line {reader.line_num}: {error}: is there a stray quote?"
        ) from None


def _parse_table(reader: csv.DictReader[str], table: Path) -> dict[str, Geodetic]:
    header = reader.fieldnames = [name.strip() for name in reader.fieldnames or ()]
    require_commas(header, str(table))
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
            raise InputError(
                f"{table}, line {reader.line_num}: {row['name']} is listed twice: remove one"
            )
        places[row["name"]] = place
    return places


def local_positions(
    images: Sequence[FlightImage], origin: Geodetic | None = None
) -> tuple[Geodetic, dict[str, NDArray[np.float64]]]:
    """Return the origin of a local frame, and the photographs' positions (3,) in it.

    Positions are by name, metres east, north and up; up is NaN where the altitude is unknown.

    Args:
        images: The photographs.
        origin: Known origin; then no photograph needs a position. None takes the median position.

    Raises:
        InputError: The origin is not given, and fewer than three photographs have a position, none
            has an altitude, or most positions are equal.
    """
    known: Mapping[str, Geodetic] = {
        image.name: image.exif.position for image in images if image.exif.position is not None
    }
    if origin is None:
        if len(known) < MIN_PHOTOGRAPHS:
            raise InputError(
                f"{len(known)} of {len(images)} photographs have a GPS position, "
                f"{MIN_PHOTOGRAPHS} are needed to georegister the scene: give --gps CSV with "
                "columns "
                f"{','.join(_COLUMNS)}"
            )
        _require_altitudes(known)
        origin = median_place(list(known.values()))
        east_north = np.array([_enu(place, origin)[:2] for place in known.values()])
        equal = np.linalg.norm(east_north - np.median(east_north, 0), axis=1) < _EQUAL_M
        if 2 * equal.sum() > len(known):
            raise InputError(
                f"{equal.sum()} of {len(known)} GPS positions are equal, so scale and direction "
                "are unknown: leave these photographs out, or give --gps CSV with columns "
                f"{','.join(_COLUMNS)}"
            )
    return origin, {name: _enu(place, origin) for name, place in known.items()}


def _require_altitudes(known: Mapping[str, Geodetic]) -> None:
    """Refuse positions if none has an altitude; warn if only some have one."""
    with_altitude = sum(not math.isnan(place.altitude) for place in known.values())
    if with_altitude == 0:
        raise InputError(
            f"none of {len(known)} photographs with a GPS position has an altitude (GPSAltitude), "
            "so the height of the scene is unknown: give --gps CSV with columns "
            f"{','.join(_COLUMNS)}"
        )
    if with_altitude < len(known):
        log.warning(
            "%d of %d photographs with a GPS position have an altitude (GPSAltitude): they alone "
            "determine the height of the scene",
            with_altitude,
            len(known),
        )


def _enu(place: Geodetic, origin: Geodetic) -> NDArray[np.float64]:
    """Return east, north and up of a position, (3,) metres; up is NaN where the altitude is."""
    if not math.isnan(place.altitude):
        return enu_from_geodetic(place, origin)
    enu = enu_from_geodetic(place._replace(altitude=origin.altitude), origin)
    return np.array([*enu[:2], np.nan])
