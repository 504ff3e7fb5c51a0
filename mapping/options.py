"""Options of building a map. The report of the map records them."""

from __future__ import annotations

from pydantic import Field

from scene.colmap.options import AdjustmentOptions, MatchOptions
from scene.config import Config


class PairOptions(Config):
    """Which photographs of a map are matched with each other."""

    min_overlap: float = Field(
        0.2,
        ge=0,
        lt=1,
        description="Share of one picture that must be seen in the other for a pair to be matched.",
    )
    max_neighbours: int = Field(
        20,
        ge=1,
        description="Most others that a photograph is matched with, those of largest overlap.",
    )
    following: int = Field(
        4,
        ge=0,
        description="Photographs taken next that each one is matched with if they overlap at all: "
        "through them flights hang together whose photographs hardly overlap.",
    )


class MapOptions(Config):
    """How a map is built."""

    pairs: PairOptions = Field(PairOptions(), description="Which photographs are matched.")
    matching: MatchOptions = Field(MatchOptions(), description="Which of their features match.")
    adjustment: AdjustmentOptions = Field(
        AdjustmentOptions(), description="How structure from motion is adjusted and aligned."
    )
