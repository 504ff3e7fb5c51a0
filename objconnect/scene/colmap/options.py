"""Options of features, of matching and of structure from motion.

The configuration of a map contains the last two.
"""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field

from objconnect.scene.config import Config


@dataclass(frozen=True)
class SiftOptions:
    """The options of COLMAP's SIFT: difference of Gaussians, RootSIFT (L1-root) descriptors.

    Attributes:
        max_features: largest number of features of an image.
        peak_threshold: smallest response of the difference of Gaussians.
        upright: whether to leave out the orientation of keypoints.
    """

    max_features: int = 8192
    peak_threshold: float = 0.02 / 3
    upright: bool = False


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
