"""Conversion of a band's pixel values to metres, from its scale, offset and unit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from objconnect.scene.quantities.lengths import metres_per
from objconnect.scene.quantities.reading import Reading, known, unknown

NO_UNIT: Final = "no unit"
"""The warning about a band whose heights have no unit."""

# Units whose lengths differ relatively by less than this are treated as equal, for example
# international and US survey feet (2e-6).
_UNIT_TOLERANCE = 1e-5


@dataclass(frozen=True)
class BandToMetres:
    """Conversion of an elevation raster band's pixel values to metres: ``factor * v + offset``."""

    factor: float = 1.0
    offset: float = 0.0

    @property
    def is_metres(self) -> bool:
        """Return whether the pixel values are metres."""
        return (self.factor, self.offset) == (1.0, 0.0)


def band_to_metres(
    unit: str | None,
    scale: float,
    offset: float,
    system_unit_m: float | None,
    key: float | str | None = None,
) -> Reading[BandToMetres]:
    """Return the conversion of a band's pixel values to metres.

    Args:
        unit: the band's unit, such as ``US survey foot``; None or empty if the file names none.
        scale: the height in the unit is ``scale * value + offset``.
        offset: see ``scale``.
        system_unit_m: length of the reference system's unit of heights, metres, which holds for a
            band without a unit; None if the system has no heights.
        key: length in metres of the unit in VerticalUnitsGeoKey; the key's text if that unit is not
            recognized.

    Returns:
        The conversion. If no source names a unit, values are taken as metres, with a warning.
    """
    if not (math.isfinite(scale) and math.isfinite(offset)) or scale == 0:
        return unknown("the height", f"the band's scale is {scale:g}, its offset {offset:g}")
    if isinstance(key, str):
        return unknown("the unit of heights", f"{key} is not known")
    named = (unit or "").strip()
    length = metres_per(named) if named else system_unit_m
    if named and length is None:
        return unknown("the band's unit", f"{named[:40]!r} is not a known unit of length")
    others = {"the reference system": system_unit_m, "VerticalUnitsGeoKey": key}
    for other, other_m in others.items():
        if length and other_m and abs(length / other_m - 1) > _UNIT_TOLERANCE:
            stated = repr(named[:40]) if named else f"of {length:g} m"
            return unknown("the band's unit", f"it is {stated}, in {other} it is {other_m:g} m")
    length = length or key
    if length is None:
        return known(BandToMetres(scale, offset), "the band", NO_UNIT)
    return known(BandToMetres(scale * length, offset * length), "the band's unit")
