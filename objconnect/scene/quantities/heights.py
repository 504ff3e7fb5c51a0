"""Heights of a band: its numbers in metres, by its scale, its offset and its unit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from objconnect.scene.quantities.lengths import metres_per
from objconnect.scene.quantities.reading import Reading, known, unknown

NO_UNIT: Final = "no unit"
"""The doubt on a band whose heights have no unit."""

# Feet of the two kinds differ by less, and no two other units do.
_SAME = 1e-5


@dataclass(frozen=True)
class MetresOfBand:
    """Metres of the numbers of a band: ``factor * number + offset``."""

    factor: float = 1.0
    offset: float = 0.0

    @property
    def is_plain(self) -> bool:
        """Return whether the numbers are metres."""
        return (self.factor, self.offset) == (1.0, 0.0)


def metres_of_band(
    unit: str | None,
    scale: float,
    offset: float,
    system_unit_m: float | None,
    key: float | str | None = None,
) -> Reading[MetresOfBand]:
    """Return how a band's numbers become metres.

    Args:
        unit: the band's unit, as ``US survey foot``; None or empty where the file names none.
        scale: what numbers are multiplied with, which gives the unit after ``offset`` is added.
        offset: what is added, in the unit.
        system_unit_m: length of the unit of heights in the reference system, metres; None where it
            has no heights. A band without a unit has this one.
        key: unit of heights in the file's own keys, metres; its name where it is not known.

    Returns:
        The metres. Where nothing names a unit, they are the file's numbers, with a doubt.
    """
    if not (math.isfinite(scale) and math.isfinite(offset)) or scale == 0:
        return unknown("the height", f"the band's scale is {scale:g}, its offset {offset:g}")
    if isinstance(key, str):
        return unknown("the unit of heights", f"{key} is not known")
    named = (unit or "").strip()
    length = metres_per(named) if named else system_unit_m
    if named and length is None:
        return unknown("the band's unit", f"{named[:40]!r} is no unit of length that is known")
    others = {"the reference system": system_unit_m, "VerticalUnitsGeoKey": key}
    for other, other_m in others.items():
        if length and other_m and abs(length / other_m - 1) > _SAME:
            said = repr(named[:40]) if named else f"of {length:g} m"
            return unknown("the band's unit", f"it is {said}, that of {other} {other_m:g} m")
    length = length or key
    if length is None:
        return known(MetresOfBand(scale, offset), "the band", NO_UNIT)
    return known(MetresOfBand(scale * length, offset * length), "the band's unit")
