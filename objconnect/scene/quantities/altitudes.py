"""The altitude of a photograph from EXIF or XMP.

``GPSAltitudeRef`` is 0 or 1 in EXIF 2.3 (above or below sea level) and 0 to 3 in EXIF 3.0 (above or
below the ellipsoid, above or below sea level), with the default 0. Drones write 0 for both
references, so only 2 and 3 are unambiguous.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from objconnect.scene.quantities.numbers import plain_text, to_number
from objconnect.scene.quantities.reading import Reading, known, unknown

# No aircraft flies higher than this (m).
_HIGHEST_M: Final = 1e6
LARGEST_DIFFERENCE_M: Final = 150.0
"""Largest difference (m) of altitudes above the ellipsoid and above the sea, with barometer
drift."""
SEA_LEVEL_DOUBT: Final = "says sea level, which may be 100 m from the ellipsoid"
"""End of the warning about an altitude that refers to sea level."""

# Values of GPSAltitudeRef: those that mean below the reference, those that mean sea level as the
# reference, and all.
_BELOW: Final = (1, 3)
_SEA_LEVEL: Final = (2, 3)
_REFERENCES: Final = (0, 1, 2, 3)


def read_altitude(gps: Mapping[str, object], xmp: Mapping[str, str]) -> Reading[float]:
    """Return the altitude of a photograph, metres.

    EXIF takes precedence over XMP unless it lacks ``GPSAltitudeRef``. The altitude is unknown if
    the two differ by more than sea level and ellipsoid can differ. A height above the take-off is
    not used.

    Args:
        gps: fields of EXIF's GPS directory by name.
        xmp: fields of XMP by name without prefix.
    """
    from_exif, from_xmp = _read_exif(gps, ""), _read_xmp(xmp)
    if from_exif.value is not None and from_xmp.value is not None:
        if abs(from_exif.value - from_xmp.value) > LARGEST_DIFFERENCE_M:
            why = (
                f"{from_exif.source} {from_exif.value:.0f} m contradicts "
                f"{from_xmp.source} {from_xmp.value:.0f} m"
            )
            return unknown(from_exif.source, why)
        # Without its reference, EXIF's altitude has no sign.
        return from_exif if gps.get("GPSAltitudeRef") is not None else from_xmp
    if from_exif.value is not None:
        return from_exif
    if from_xmp.value is not None:
        stated = [doubt for doubt in from_exif.doubts if not doubt.endswith("is missing")]
        return from_xmp.with_doubts(*stated)
    relative = ["RelativeAltitude is above the take-off"] if "RelativeAltitude" in xmp else ()
    return from_exif.with_doubts(*from_xmp.doubts, *relative)


def _read_exif(fields: Mapping[str, object], prefix: str) -> Reading[float]:
    source = f"{prefix}GPSAltitude"
    value = fields.get("GPSAltitude")
    if value is None:
        return unknown(source, f"{source} is missing")
    metres = to_number(_quotient(value))
    if not abs(metres) <= _HIGHEST_M:
        return unknown(source, f"{source} is not a number of metres")
    reference = fields.get("GPSAltitudeRef")
    if reference is None:
        # 0 is the default of the standard.
        return known(metres, source, f"{source}Ref is missing: taken as 0 (above), EXIF's default")
    number = _reference(reference)
    if number is None:
        return unknown(source, f"{source}Ref {plain_text(reference)!r} is not 0 to 3")
    if number in _BELOW and metres < 0:
        return unknown(source, f"{source} is negative and {source}Ref says below as well")
    metres = -metres if number in _BELOW else metres
    if number in _SEA_LEVEL:
        return known(metres, source, f"{source}Ref {number} {SEA_LEVEL_DOUBT}")
    return known(metres, source)


def _quotient(value: object) -> object:
    """Return the value of a fraction such as ``198600/1000``; anything else unchanged."""
    if not isinstance(value, str) or "/" not in value:
        return value
    top, _, bottom = value.partition("/")
    numerator, denominator = to_number(top), to_number(bottom)
    return numerator / denominator if denominator else math.nan


def _reference(value: object) -> int | None:
    """Return the number of an altitude reference, which is a byte, a digit or a number."""
    if isinstance(value, bytes) and len(value) == 1 and value[0] in _REFERENCES:
        return value[0]
    number = to_number(value) if plain_text(value) else math.nan
    return int(number) if number in _REFERENCES else None


def _read_xmp(xmp: Mapping[str, str]) -> Reading[float]:
    """Return the altitude of ``AbsoluteAltitude``, or of EXIF's fields in XMP."""
    if "AbsoluteAltitude" in xmp:
        metres = to_number(xmp["AbsoluteAltitude"])
        if abs(metres) <= _HIGHEST_M:
            return known(metres, "XMP's AbsoluteAltitude")
        return unknown("XMP's AbsoluteAltitude", "XMP's AbsoluteAltitude is not a number of metres")
    if "GPSAltitude" in xmp:
        return _read_exif(xmp, "XMP's ")
    return unknown("XMP's AbsoluteAltitude")
