"""The positions at which photographs were taken, from their EXIF or from a table."""

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

FEWEST = 3
# Positions nearer to one another than this, metres, are those of a receiver that is stuck.
_ONE_PLACE_M = 0.01
_COLUMNS = ("name", "lat", "lon", "alt")


def with_positions(flight: Flight, table: Path) -> Flight:
    """Return the flight with the positions of a table instead of those in EXIF.

    Args:
        flight: The photographs.
        table: CSV file with a header. The column ``name`` is the name of a file, or its path in
            the folder; ``lat`` and ``lon`` are degrees, ``alt`` is metres. Other columns do not
            count, nor do rows of photographs that are not in the flight. Names are compared
            as ``match_files`` does.

    Raises:
        InputError: The table cannot be read, lacks a column or has one twice, holds a bad number
            or a name twice, has a name without a folder that several photographs share, or has
            none of the photographs.
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
            f"{table} has none of the photographs: its first name is {next(iter(places))!r}, that "
            f"of the first photograph {flight.images[0].file!r}"
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
            raise InputError(f"{table}, line {reader.line_num}: {row['name']} is there twice")
        places[row["name"]] = place
    return places


def local(
    images: Sequence[FlightImage], origin: Geodetic | None = None
) -> tuple[Geodetic, dict[str, NDArray[np.float64]]]:
    """Return an origin amid the photographs, and their positions (3,) from it.

    Positions are by name, metres east, north and up; up is NaN where the altitude is unknown.

    Args:
        images: The photographs.
        origin: An origin that is known; then no photograph needs a position.

    Raises:
        InputError: Fewer than three photographs have a position, none has an altitude, or most
            positions are one, and the origin is not known.
    """
    known: Mapping[str, Geodetic] = {
        image.name: image.exif.position for image in images if image.exif.position is not None
    }
    if origin is None:
        if len(known) < FEWEST:
            raise InputError(
                f"{len(known)} of {len(images)} photographs have a GPS position, {FEWEST} are "
                "needed, for a scene has metres and a place on earth: give --gps CSV with columns "
                f"{','.join(_COLUMNS)}"
            )
        _require_altitudes(known)
        origin = median_place(list(known.values()))
        east_north = np.array([_from(place, origin)[:2] for place in known.values()])
        at_one = np.linalg.norm(east_north - np.median(east_north, 0), axis=1) < _ONE_PLACE_M
        if 2 * at_one.sum() > len(known):
            raise InputError(
                f"{at_one.sum()} of {len(known)} GPS positions are one: they do not tell scale and "
                "direction: leave these photographs out, or give --gps CSV with columns "
                f"{','.join(_COLUMNS)}"
            )
    return origin, {name: _from(place, origin) for name, place in known.items()}


def _require_altitudes(known: Mapping[str, Geodetic]) -> None:
    """Refuse positions of which none has an altitude; warn where few have one."""
    high = sum(not math.isnan(place.altitude) for place in known.values())
    if high == 0:
        raise InputError(
            f"none of {len(known)} photographs with a GPS position has an altitude (GPSAltitude), "
            "so that the height of the scene is unknown: give --gps CSV with columns "
            f"{','.join(_COLUMNS)}"
        )
    if high < len(known):
        log.warning(
            "%d of %d photographs with a GPS position have an altitude (GPSAltitude): the height "
            "of the scene is that of these",
            high,
            len(known),
        )


def _from(place: Geodetic, origin: Geodetic) -> NDArray[np.float64]:
    """Return east, north and up of a place, (3,) metres; up is NaN where the altitude is."""
    if not math.isnan(place.altitude):
        return enu_from_geodetic(place, origin)
    enu = enu_from_geodetic(place._replace(altitude=origin.altitude), origin)
    return np.array([*enu[:2], np.nan])
