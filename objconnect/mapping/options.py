"""Options of ``map``, which the map's report records."""

from __future__ import annotations

from pydantic import Field

from objconnect.scene.config import Config


class MapOptions(Config):
    """Options that decide which map photographs are matched with each other."""

    min_overlap: float = Field(
        0.2,
        ge=0,
        lt=1,
        description="Minimum overlap of a pair: the share (0 to 1) of each photograph's surface "
        "that the other shows.",
    )
    max_neighbours: int = Field(
        20,
        ge=1,
        description="Maximum number of photographs with which each photograph is matched, by "
        "decreasing overlap. Pairs that only the other photograph chose are not counted.",
    )
    following: int = Field(
        4,
        ge=0,
        description="Number of following photographs with which each one is matched if they "
        "overlap at all. This connects the photographs of flights with little overlap.",
    )
