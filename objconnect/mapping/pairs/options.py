"""Options of the query photographs that are rendered from an orthophoto."""

from __future__ import annotations

from pydantic import Field, field_validator

from objconnect.scene.config import MAX_NUMBER, Config


class PairQueryOptions(Config):
    """Options of a data set of two orthophotos, which ``pair.json`` records."""

    queries: int = Field(24, ge=1, le=2000, description="Number of queries.")
    size: int = Field(512, ge=64, le=4096, description="Side of the square queries, px.")
    fov_deg: float = Field(60.0, ge=10, le=120, description="Field of view of the queries, deg.")
    tilt_deg: float = Field(
        12.0,
        ge=0,
        le=45,
        description="Largest tilt from the vertical, in any direction, deg. Without a surface "
        "model, strongly tilted views show roofs and trees as if painted on the ground.",
    )
    height_m: tuple[float, float] | None = Field(
        None,
        description="Lowest and highest height of the queries above the ground, m. None chooses "
        "heights at which a pixel of a query is 0.8 to 1.6 times as large on the ground as one of "
        "the orthophoto.",
    )
    noise: float = Field(
        2.0, ge=0, le=50, description="Standard deviation of the noise of a pixel, grey levels."
    )
    blur_px: float = Field(
        0.6, ge=0, le=10, description="Standard deviation of the Gaussian blur of a query, px."
    )
    vignetting: float = Field(
        0.15, ge=0, le=0.9, description="Share of the brightness that is lost in the corners."
    )
    jpeg_quality: int = Field(90, ge=1, le=100, description="Quality of the JPEG files.")
    seed: int = Field(0, ge=0, le=MAX_NUMBER, description="Seed of the poses and of the noise.")

    @field_validator("height_m")
    @classmethod
    def _is_range(cls, heights: tuple[float, float] | None) -> tuple[float, float] | None:
        if heights is not None and not 1 <= heights[0] <= heights[1] <= 10_000:
            raise ValueError("the lower height comes first, and both are from 1 to 10000 m")
        return heights
