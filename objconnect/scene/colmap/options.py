"""Options of features, and the limits of matching and of structure from motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

MAX_RATIO: Final = 0.8
"""Largest ratio of the distances to the nearest and the second nearest descriptor of a match;
COLMAP's own default."""

EPIPOLAR_PX: Final = 2.0
"""Largest distance (px) of a match from its epipolar line: half of COLMAP's default, because
the lens is known."""

GUESSED_EPIPOLAR_PX: Final = 4.0
"""The same where the lens is not calibrated yet; COLMAP's own default."""

OUTLIER_SIGMAS: Final = 5.0
"""Observations with a residual of more standard deviations leave a model: of noise alone four
in a million are as large."""

MIN_ANGLE_DEG: Final = 1.5
"""Points whose rays intersect at smaller angles leave a model; COLMAP's own default."""

ALIGN_M: Final = 1.0
"""Cameras further than this (m) from their known centres are outliers of the alignment."""


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
