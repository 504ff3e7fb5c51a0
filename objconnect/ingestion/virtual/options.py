"""Options of virtual views."""

from __future__ import annotations

from pydantic import Field

from objconnect.scene.config import Config


class ViewOptions(Config):
    """Options of the virtual views of an orthophoto."""

    altitude: float | None = Field(
        None,
        ge=1,
        le=10_000,
        description="Height of the cameras above the ground, m. None chooses the height at which a "
        "pixel of a view is as large on the ground as a pixel of the orthophoto.",
    )
    overlap: float = Field(
        0.7,
        ge=0,
        le=0.95,
        description="Overlap of neighbouring nadir views, as a share of their side.",
    )
    tilt: float = Field(
        0.0,
        ge=0,
        le=60,
        description="Tilt from the vertical of additional views to the north, east, south and "
        "west, deg. 0 adds none.",
    )
    size: int = Field(512, ge=64, le=4096, description="Side of the square views, px.")
