"""Options of SIFT, and thresholds of matching and structure from motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

MAX_RATIO: Final = 0.8
"""Largest ratio of the distances to the nearest and the second nearest descriptor of a match;
COLMAP's own default."""

EPIPOLAR_PX: Final = 2.0
"""Largest distance (px) of a match from its epipolar line for a calibrated lens; half of COLMAP's
default."""

GUESSED_EPIPOLAR_PX: Final = 4.0
"""Largest distance (px) of a match from its epipolar line for an uncalibrated lens; COLMAP's own
default."""

OUTLIER_SIGMAS: Final = 5.0
"""Length of a residual, in standard deviations, above which an observation is removed. Four in
a million normally distributed residuals are longer."""

MIN_ANGLE_DEG: Final = 1.5
"""Triangulation angle below which points are removed; COLMAP's own default."""

MAX_ALIGNMENT_ERROR_M: Final = 1.0
"""Largest distance (m) of inlier cameras from their known centres in the alignment."""


@dataclass(frozen=True)
class SiftOptions:
    """The options of COLMAP's SIFT: difference of Gaussians, RootSIFT (L1-root) descriptors.

    Attributes:
        max_features: largest number of features per image.
        peak_threshold: smallest response of the difference of Gaussians.
        upright: whether keypoints have no orientation.
    """

    max_features: int = 8192
    peak_threshold: float = 0.02 / 3
    upright: bool = False
