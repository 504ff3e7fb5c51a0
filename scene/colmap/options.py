"""Options of matching and of structure from motion; the configuration of a map contains them."""

from __future__ import annotations

from pydantic import Field

from scene.config import Config


class MatchOptions(Config):
    """Limits within which features of two photographs match."""

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
        description="Largest distance (px) of a match from its epipolar line where the lens is not "
        "calibrated yet; COLMAP's own default.",
    )


class AdjustmentOptions(Config):
    """Adjustment of a model of structure from motion, and alignment to known camera centres."""

    outlier_sigmas: float = Field(
        5.0,
        gt=0,
        description="Observations with a residual of more standard deviations are removed.",
    )
    min_angle_deg: float = Field(
        1.5,
        ge=0,
        description="Points whose rays intersect at smaller angles are removed; COLMAP's own "
        "default.",
    )
    align_m: float = Field(
        1.0,
        gt=0,
        description="Cameras further than this (m) from their known centres are outliers of the "
        "alignment.",
    )
