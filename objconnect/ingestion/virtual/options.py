"""Options of the virtual views of an orthophoto."""

from __future__ import annotations

from pydantic import Field

from objconnect.scene.config import Config


class ViewOptions(Config):
    """Where virtual views of an orthophoto are taken from, and how."""

    altitude: float | None = Field(
        None,
        ge=1,
        le=10_000,
        description="Height of the cameras above the ground, metres. None is the height from which "
        "a pixel of a view is as large on the ground as one of the orthophoto.",
    )
    overlap: float = Field(
        0.7,
        ge=0,
        le=0.95,
        description="Share of a view from above that the next one shows too.",
    )
    tilt: float = Field(
        0.0,
        ge=0,
        le=60,
        description="Angle between the vertical and further views to the north, east, south and "
        "west, degrees. 0 takes none.",
    )
    size: int = Field(512, ge=64, le=4096, description="Side of a view, pixels.")
