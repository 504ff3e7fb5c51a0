"""Numbers in texts, whose decimal mark may be a point or a comma."""

from __future__ import annotations

import math
import re

_NUMBER = re.compile(r"[-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][-+]?\d+)?")


def parse_number(text: str) -> float | None:
    """Return the number that a text holds and nothing else; None where there is none.

    A single comma is a decimal mark. A text with several marks, as ``1.234,5``, is not a number:
    either mark may divide thousands.

    Example:
        >>> parse_number(" 47.5 "), parse_number("47,5"), parse_number("1.234,5")
        (47.5, 47.5, None)
    """
    text = text.strip()
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text.replace(",", "."))
    return value if math.isfinite(value) else None
