"""Parsing of numbers whose decimal mark may be a point or a comma."""

from __future__ import annotations

import math
import re

_NUMBER = re.compile(r"[-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][-+]?\d+)?")


def parse_number(text: str) -> float | None:
    """Return the number in a text; None if the text is anything else.

    A single comma is a decimal mark. A text with several marks, such as ``1.234,5``, is not a
    number: either mark may separate thousands.

    Examples:
        >>> parse_number(" 47.5 "), parse_number("47,5"), parse_number("1.234,5")
        (47.5, 47.5, None)
    """
    text = text.strip()
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text.replace(",", "."))
    return value if math.isfinite(value) else None


def to_number(value: object) -> float:
    """Return a number of EXIF, which may be a rational or a text; NaN if invalid, such as 0/0."""
    if isinstance(value, tuple | list) and len(value) == 1:
        value = value[0]
    if isinstance(value, str | bytes):
        number = parse_number(plain_text(value))
        return math.nan if number is None else number
    try:
        return float(value)  # type: ignore[arg-type]
    except (ArithmeticError, TypeError, ValueError, AttributeError):
        return math.nan


def plain_text(value: object) -> str:
    """Return a text of EXIF without its padding of zero bytes and white space."""
    if isinstance(value, tuple | list) and len(value) == 1:
        value = value[0]
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    return str(value if value is not None else "").strip("\0 \t\r\n")
