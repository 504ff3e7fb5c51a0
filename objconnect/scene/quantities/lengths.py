"""Units of length by their names in files."""

from __future__ import annotations

import re
from typing import Final

_FOOT: Final = 0.3048
_US_FOOT: Final = 1200 / 3937

# Keys are lower case, without white space, punctuation and plural s.
_METRES: Final = {
    "m": 1.0,
    "metre": 1.0,
    "meter": 1.0,
    "mètre": 1.0,
    "metro": 1.0,
    "dm": 0.1,
    "decimetre": 0.1,
    "decimeter": 0.1,
    "cm": 0.01,
    "centimetre": 0.01,
    "centimeter": 0.01,
    "mm": 0.001,
    "millimetre": 0.001,
    "millimeter": 0.001,
    "km": 1000.0,
    "kilometre": 1000.0,
    "kilometer": 1000.0,
    "ft": _FOOT,
    "foot": _FOOT,
    "feet": _FOOT,
    "internationalfoot": _FOOT,
    "internationalfeet": _FOOT,
    "footinternational": _FOOT,
    "usft": _US_FOOT,
    "ftus": _US_FOOT,
    "usfoot": _US_FOOT,
    "footus": _US_FOOT,
    "ussurveyfoot": _US_FOOT,
    "ussurveyfeet": _US_FOOT,
    "surveyfoot": _US_FOOT,
    "surveyfeet": _US_FOOT,
    "yd": 0.9144,
    "yard": 0.9144,
    "in": 0.0254,
    "inch": 0.0254,
}


def metres_per(unit: str) -> float | None:
    """Return the length of a unit, metres; None if the name is unknown.

    Examples:
        >>> metres_per("Metres"), metres_per("foot"), round(metres_per("US survey foot"), 9)
        (1.0, 0.3048, 0.30480061)
        >>> metres_per("fathom") is None
        True
    """
    name = re.sub(r"[\s_.()\[\]-]", "", unit.lower())
    return _METRES.get(name, _METRES.get(name.removesuffix("s")))
