"""Options of matching and of structure from motion; a configuration of a map holds them."""

from __future__ import annotations

from pydantic import Field

from scene.config import Config


class MatchOptions(Config):
    """Which features of two photographs match."""

    max_ratio: float = Field(
        0.8,
        gt=0,
        le=1,
        description="Largest ratio of the distances to the nearest and the second nearest "
        "descriptor; COLMAP's own default.",
    )
    epipolar_px: float = Field(
        2.0, gt=0, description="Largest distance (px) of a match from its epipolar line."
    )
    guessed_epipolar_px: float = Field(
        4.0,
        gt=0,
        description="The same where the lens is not calibrated yet; COLMAP's own default.",
    )


class AdjustmentOptions(Config):
    """How a model of structure from motion is adjusted and aligned to known camera centres."""

    outlier_sigmas: float = Field(
        5.0,
        gt=0,
        description="Observations with a residual of more standard deviations leave the model.",
    )
    min_angle_deg: float = Field(
        1.5,
        ge=0,
        description="Points whose rays meet at smaller angles leave it; COLMAP's own default.",
    )
    align_m: float = Field(
        1.0,
        gt=0,
        description="Largest distance (m) of a camera from its known centre for it to count in "
        "the alignment.",
    )
