"""How high a photograph was taken: the altitude of EXIF, of XMP, or unknown.

``GPSAltitudeRef`` is 0 or 1 in EXIF 2.3 (above or below sea level) and 0 to 3 in EXIF 3.0 (above or
below the ellipsoid, above or below sea level). It has a default, 0, in both. Drones write heights
of either kind as 0, so that only 2 and 3 tell which it is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from objconnect.scene.quantities.numbers import plain_text, to_number
from objconnect.scene.quantities.reading import Reading, known, unknown

# No aircraft flies higher than this (m).
_HIGHEST_M: Final = 1e6
# The ellipsoid and the sea are at most this far from each other (m), and barometers drift.
_APART_M: Final = 150.0
OF_SEA_LEVEL: Final = "says sea level, which may be 100 m from the ellipsoid"
"""How the doubt ends on an altitude whose reference says that it is above or below sea level."""

_BELOW: Final = (1, 3)
_OF_THE_SEA: Final = (2, 3)
_REFERENCES: Final = (0, 1, 2, 3)


def read_altitude(gps: Mapping[str, object], xmp: Mapping[str, str]) -> Reading[float]:
    """Return the altitude of a photograph, metres.

    EXIF's altitude counts where it is whole, then XMP's. Where they contradict each other by more
    than two height systems do, it is unknown. A height above the take-off is none.

    Args:
        gps: Fields of EXIF's GPS directory by name.
        xmp: Fields of XMP by name without prefix.
    """
    told, said = _of_exif(gps, ""), _of_xmp(xmp)
    if told.value is not None and said.value is not None:
        if abs(told.value - said.value) > _APART_M:
            why = f"{told.source} {told.value:.0f} m contradicts {said.source} {said.value:.0f} m"
            return unknown(told.source, why)
        # What only one of them tells is the sign where the reference is missing.
        return told if gps.get("GPSAltitudeRef") is not None else said
    if told.value is not None:
        return told
    if said.value is not None:
        stated = [doubt for doubt in told.doubts if not doubt.endswith("is missing")]
        return said.with_doubts(*stated)
    relative = [f"{name} is above the take-off" for name in ("RelativeAltitude",) if name in xmp]
    return told.with_doubts(*said.doubts, *relative)


def _of_exif(fields: Mapping[str, object], prefix: str) -> Reading[float]:
    source = f"{prefix}GPSAltitude"
    value = fields.get("GPSAltitude")
    if value is None:
        return unknown(source, f"{source} is missing")
    metres = to_number(_quotient(value))
    if not abs(metres) <= _HIGHEST_M:
        return unknown(source, f"{source} is no number of metres")
    reference = fields.get("GPSAltitudeRef")
    if reference is None:
        # A default of the standard, which is true where a program left it out for that reason.
        return known(metres, source, f"{source}Ref is missing: taken as above, EXIF's default")
    number = _reference(reference)
    if number is None:
        return unknown(source, f"{source}Ref {plain_text(reference)!r} is none of 0 to 3")
    if number in _BELOW and metres < 0:
        return unknown(source, f"{source} is negative and {source}Ref says below as well")
    metres = -metres if number in _BELOW else metres
    if number in _OF_THE_SEA:
        return known(metres, source, f"{source}Ref {number} {OF_SEA_LEVEL}")
    return known(metres, source)


def _quotient(value: object) -> object:
    """Return the number of a text such as ``198600/1000``, and anything else as it is."""
    if not isinstance(value, str) or "/" not in value:
        return value
    top, _, bottom = value.partition("/")
    above, below = to_number(top), to_number(bottom)
    return above / below if below else math.nan


def _reference(value: object) -> int | None:
    """Return the number of a reference, which may be a byte, a digit or a number."""
    if isinstance(value, bytes) and len(value) == 1 and value[0] in _REFERENCES:
        return value[0]
    number = to_number(value) if plain_text(value) else math.nan
    return int(number) if number in _REFERENCES else None


def _of_xmp(xmp: Mapping[str, str]) -> Reading[float]:
    """Return the absolute altitude of a drone, or that of EXIF's fields in XMP."""
    if "AbsoluteAltitude" in xmp:
        metres = to_number(xmp["AbsoluteAltitude"])
        if abs(metres) <= _HIGHEST_M:
            return known(metres, "XMP's AbsoluteAltitude")
        return unknown("XMP's AbsoluteAltitude", "XMP's AbsoluteAltitude is no number of metres")
    if "GPSAltitude" in xmp:
        return _of_exif(xmp, "XMP's ")
    return unknown("XMP's AbsoluteAltitude")
