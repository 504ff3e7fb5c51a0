"""Options of building a map. The report of the map records them."""

from __future__ import annotations

from pydantic import Field

from objconnect.scene.config import Config


class MapOptions(Config):
    """The choice of photographs of a map that are matched with each other."""

    min_overlap: float = Field(
        0.2,
        ge=0,
        lt=1,
        description="A pair is matched when each picture shows at least this share of the other.",
    )
    max_neighbours: int = Field(
        20,
        ge=1,
        description="Each picture is matched with at most this many others, those of largest "
        "overlap.",
    )
    following: int = Field(
        4,
        ge=0,
        description="Number of following photographs with which each one is matched if they "
        "overlap at all. This connects flights whose photographs hardly overlap.",
    )
