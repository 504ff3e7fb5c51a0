"""Parsing of the coordinate reference systems that the first lines of ODM's files name.

A line is ``EPSG:n``, ``WGS84 UTM 32N``, WKT or a PROJ string. A system that defines heights has a
unit of heights. In a two-dimensional system heights are metres if coordinates are metres or
degrees; if coordinates are feet, the unit of heights is unknown unless the line has ``+vunits`` or
``+vto_meter``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.quantities.lengths import metres_per
from objconnect.scene.quantities.numbers import parse_number
from objconnect.scene.quantities.reading import Reading, known, unknown
from objconnect.scene.runtime.escaping import for_terminal

_UTM = re.compile(r"WGS ?84[ /]*UTM(?: zone)? ?(\d{1,2}) ?([NS])", re.IGNORECASE)
_VERTICAL = re.compile(r"\s*\+(vunits|vto_meter)=(\S+)", re.IGNORECASE)


@dataclass(frozen=True)
class NamedSystem:
    """A reference system with the unit of its heights.

    Attributes:
        projection: the system, with or without heights.
        height_unit: metres per unit of height; 1 for a system with heights, which the projection
            converts.
    """

    projection: Projection
    height_unit: Reading[float]

    def to_geodetic(self, coordinates: NDArray[np.float64], where: str) -> Geodetic:
        """Convert east, north and height, (3,) in the system's units, to a place.

        Raises:
            InputError: the coordinates are outside the system's range, or the unit of heights is
                unknown.
        """
        unit = self.height_unit.require(
            where,
            "name a system with heights, or add +vunits=us-ft, +vunits=ft or +vunits=m to the line",
        )
        return self.projection.to_geodetic(coordinates * [1.0, 1.0, unit])


def parse_system(line: str, where: str) -> NamedSystem:
    """Return the system that a line names.

    Args:
        line: name of the system, EPSG code, WKT or PROJ string.
        where: file and line, for messages.

    Raises:
        InputError: PROJ knows no such system, or pyproj is not installed.
    """
    name = " ".join(line.split()).strip("'\"").strip()
    stated: list[tuple[str, str]] = []
    if not name.startswith("+"):  # PROJ reads these parameters, but not after a code
        stated = _VERTICAL.findall(name)
        name = _VERTICAL.sub("", name).strip()
    utm = _UTM.fullmatch(name)
    if utm is not None:
        if not 1 <= int(utm[1]) <= 60:
            raise InputError(f"{where}: UTM has no zone {utm[1]}")
        name = f"EPSG:{326 if utm[2].upper() == 'N' else 327}{int(utm[1]):02d}"
    try:
        projection = Projection(name)
    except InputError as error:
        if "pyproj" in str(error):
            raise
        raise InputError(f"{where}: {error}") from None
    return NamedSystem(projection, _height_unit(name, projection, stated, where))


def _height_unit(
    name: str, projection: Projection, stated: list[tuple[str, str]], where: str
) -> Reading[float]:
    """Return the metres per unit of height."""
    factors = {_parse_metres(word, text, where) for word, text in stated}
    if len(factors) > 1:
        raise InputError(f"{where}: +vunits and +vto_meter contradict each other")
    if projection.has_heights:
        if stated:
            raise InputError(
                f"{where}: {projection.name} has heights of its own: leave +{stated[0][0]} out"
            )
        return known(1.0, projection.height_reference)
    if factors:
        return known(factors.pop(), f"+{stated[0][0]}")
    units = projection.horizontal_units
    if set(units) <= {"metre", "degree"}:
        return known(1.0, projection.name)
    return unknown(
        "the unit of heights",
        f"{for_terminal(name)} has eastings in {units[0]} and no heights",
    )


def _parse_metres(word: str, text: str, where: str) -> float:
    if word.lower() == "vunits":
        unit = metres_per(text)
        if unit is None:
            raise InputError(
                f"{where}: +{word}={text} is not a unit of length: give m, ft or us-ft"
            )
        return unit
    factor = parse_number(text)
    if factor is None or not factor > 0:
        raise InputError(
            f"{where}: +{word}={text} is not a positive number: give the metres per unit of height"
        )
    return factor
