"""The absolute accuracy of a map: the error that all its positions share on earth."""

from __future__ import annotations

import math
from typing import Final, Literal

from pydantic import Field

from objconnect.scene.storage.records import Record


class Georeference(Record):
    """The common error of all positions of a map on earth.

    Attributes:
        horizontal_m: standard deviation of the horizontal position, metres: the root of the sum of
            the variances to the east and to the north, which are equal.
        vertical_m: standard deviation of the height above the ellipsoid, metres; None if unknown.
        source: where the values come from: a simulated world ("exact"), GNSS positions ("gps"),
            surveyed points ("control") or the user ("stated").
    """

    horizontal_m: float = Field(ge=0)
    vertical_m: float | None = Field(None, ge=0)
    source: Literal["exact", "gps", "control", "stated"]

    @property
    def axis_m(self) -> float:
        """Return the standard deviation along each horizontal axis, metres."""
        return self.horizontal_m / math.sqrt(2)

    def text(self) -> str:
        """Return the standard deviations as text for the user."""
        height = "unknown" if self.vertical_m is None else f"{self.vertical_m:.2f} m"
        return f"horizontal {self.horizontal_m:.2f} m, vertical {height}"


EXACT_GEOREFERENCE: Final = Georeference(horizontal_m=0.0, vertical_m=0.0, source="exact")
"""The georeference of a simulated world, which lies exactly at its origin."""
