"""How exactly the frame of a scene is known on earth."""

from __future__ import annotations

import math
from typing import Final, Literal

from pydantic import Field

from objconnect.scene.storage.records import Record


class Georeference(Record):
    """The error that all positions of a map share on earth, however exact they are within it.

    Attributes:
        horizontal_m: Standard deviation of the horizontal position, metres: the root of the sum of
            the variances to the east and to the north. The two are taken to be equal.
        vertical_m: Standard deviation of the height above the ellipsoid, metres; None if unknown.
        source: What tells it: the world is invented ("exact"), positions of a receiver ("gps"),
            surveyed points ("control"), or a person ("stated").
    """

    horizontal_m: float = Field(ge=0)
    vertical_m: float | None = Field(None, ge=0)
    source: Literal["exact", "gps", "control", "stated"]

    @property
    def axis_m(self) -> float:
        """Return the standard deviation to the east, which is that to the north, metres."""
        return self.horizontal_m / math.sqrt(2)

    def text(self) -> str:
        """Return the figures as text."""
        height = "unknown" if self.vertical_m is None else f"{self.vertical_m:.2f} m"
        return f"horizontal {self.horizontal_m:.2f} m, vertical {height}"


EXACT: Final = Georeference(horizontal_m=0.0, vertical_m=0.0, source="exact")
"""The georeference of an invented world, which is where its origin says."""
