"""Latitudes and longitudes in the notations of EXIF and XMP.

EXIF has unsigned degrees, minutes and seconds, and the hemisphere in a separate tag. XMP has
text: ``46,50.556N`` in the namespace ``exif``, signed decimal degrees in drone makers' namespaces.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from objconnect.scene.quantities.numbers import parse_number, plain_text, to_number
from objconnect.scene.quantities.reading import Reading, known, unknown

# Tolerance of whole numbers.
_WHOLE_TOLERANCE: Final = 1e-9
_PARTS: Final = ("degrees", "minutes", "seconds")
# Separators of degrees, minutes and seconds.
_SEPARATOR = re.compile(r"[\s,;:°º'\"′″]+")
_TRAILING_LETTERS = re.compile(r"^(.*?)\s*([A-Za-z]+)\.?$", re.DOTALL)


@dataclass(frozen=True)
class Axis:
    """Latitude or longitude.

    Attributes:
        tag: name of its field in EXIF.
        positive: hemisphere of positive values, in lower case.
        negative: hemisphere of negative values, in lower case.
        limit: largest value, degrees.
    """

    tag: str
    positive: str
    negative: str
    limit: float

    @property
    def reference(self) -> str:
        """Return the name of EXIF's field of the hemisphere."""
        return f"{self.tag}Ref"


LATITUDE: Final = Axis("GPSLatitude", "north", "south", 90.0)
LONGITUDE: Final = Axis("GPSLongitude", "east", "west", 180.0)


def read_hemisphere(value: object, axis: Axis) -> Reading[int]:
    """Return the sign of a hemisphere, 1 or -1, from its letter or English word in any case."""
    if value is None:
        return unknown(axis.reference, f"{axis.reference} is missing")
    text = plain_text(value).rstrip(".").lower()
    for word, sign in ((axis.positive, 1), (axis.negative, -1)):
        if text in (word, word[0], f"{word}ern"):
            return known(sign, axis.reference)
    if not text:
        return unknown(axis.reference, f"{axis.reference} is empty")
    hemispheres = f"{axis.positive} nor {axis.negative}"
    return unknown(axis.reference, f"{axis.reference} {text!r} is neither {hemispheres}")


def read_degrees(value: object, axis: Axis) -> Reading[float]:
    """Return an angle without its hemisphere, degrees from 0 to the limit of the axis.

    Args:
        value: one to three numbers, or a text of them. Only one may have a fraction; the numbers
            after it must be missing, zero or 0/0.
        axis: latitude or longitude.
    """
    if isinstance(value, str | bytes):
        parts = _split(plain_text(value))
    elif isinstance(value, Sequence):
        parts = [to_number(part) for part in value]
    else:
        parts = [to_number(value)]
    return _degrees(parts, axis, axis.tag)


def read_coordinate(value: object, reference: object, axis: Axis) -> Reading[float]:
    """Return a latitude or longitude from EXIF, degrees, negative in the south and west."""
    if value is None:
        return unknown(axis.tag, f"{axis.tag} is missing")
    degrees, sign = read_degrees(value, axis), read_hemisphere(reference, axis)
    if degrees.value is None:
        return degrees
    if sign.value is None:
        return unknown(axis.tag, *sign.doubts)
    return known(sign.value * degrees.value, axis.tag)


def parse_coordinate(text: str, axis: Axis, source: str, *, signed: bool) -> Reading[float]:
    """Return a latitude or longitude from a text, degrees, negative in the south and west.

    Args:
        text: a text like ``46,50.556N``, ``46,50,33.36N`` or ``+46.8426``.
        axis: latitude or longitude.
        source: name of the field.
        signed: whether the field holds signed degrees, where no sign means north or east.
    """
    text = plain_text(text)
    lettered = _TRAILING_LETTERS.match(text)
    if lettered is None:
        value = _parse_decimal(text)
        if value is None:
            return unknown(source, f"{source} {text!r} is not a number of degrees")
        if not signed and text[0] not in "+-":
            return unknown(source, f"{source} {text!r} has no hemisphere")
        if not abs(value) <= axis.limit:
            return unknown(source, f"{source} {text!r} is beyond {axis.limit:.0f} degrees")
        return known(value, source)
    sign = read_hemisphere(lettered[2], axis)
    degrees = _degrees(_split(lettered[1]), axis, source)
    if sign.value is None:
        return unknown(source, f"{source} {text!r} has no hemisphere")
    if degrees.value is None:
        return degrees
    return known(sign.value * degrees.value, source)


def _parse_decimal(text: str) -> float | None:
    """Return decimal degrees; None if a comma may separate degrees and minutes."""
    if "," in text and len(text.rpartition(",")[2]) <= 2:
        return None
    return parse_number(text)


def _split(text: str) -> list[float]:
    """Return the numbers of a text, which may be fractions; NaN for other words."""
    words = [word for word in _SEPARATOR.split(text) if word]
    return [_fraction(word) for word in words]


def _fraction(word: str) -> float:
    top, divided, bottom = word.partition("/")
    numerator, denominator = parse_number(top), parse_number(bottom) if divided else 1.0
    return math.nan if numerator is None or not denominator else numerator / denominator


def _degrees(parts: Sequence[float], axis: Axis, source: str) -> Reading[float]:
    """Convert degrees, minutes and seconds to degrees; unknown with the reason if invalid."""
    why = _find_fault(parts)
    if why:
        return unknown(source, f"{source} {why}")
    degrees = sum(part / 60**k for k, part in enumerate(parts) if not math.isnan(part))
    if not degrees <= axis.limit:
        return unknown(source, f"{source} is beyond {axis.limit:.0f} degrees")
    return known(float(degrees), source)


def _find_fault(parts: Sequence[float]) -> str:
    """Return what is wrong with degrees, minutes and seconds; empty if they are valid."""
    if not parts:
        return "is empty"
    if len(parts) > 3:
        return f"has {len(parts)} numbers"
    values = list(parts)
    while values and math.isnan(values[-1]):
        values.pop()
    if not values:
        return "is 0/0"
    for name, value in zip(_PARTS, values, strict=False):
        if not math.isfinite(value):
            return f"has {name} of 0/0"
    if min(values) < 0 or math.copysign(1, min(values)) < 0:
        return "has a sign, but EXIF states the hemisphere in a separate field"
    for name, value in zip(_PARTS[1:], values[1:], strict=False):
        if value > 60:  # programs round 59.99999 to 60
            return f"has {value:g} {name}"
    for k, value in enumerate(values):
        if abs(value - round(value)) > _WHOLE_TOLERANCE and any(values[k + 1 :]):
            return f"has a fraction of {_PARTS[k]} and {_PARTS[k + 1]} as well"
    last = values[-1]
    # The fraction was probably cut off: a minute of latitude is 1.9 km.
    if len(values) < len(_PARTS) and abs(last - round(last)) <= _WHOLE_TOLERANCE:
        return f"has whole {_PARTS[len(values) - 1]} and no fraction"
    return ""
