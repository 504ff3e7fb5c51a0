"""The probability that a pose is right, that is, within 5 m and 10 degrees of the truth.

Logistic regression gives the log odds of an aligned pose from three measures that need no ground
truth (``evidence``), and the log odds of a pose from keypoint matches by its number of inliers. At
most one position in a map is right, so the probabilities of poses at several positions sum to at
most 1. ``python -m experiments.acceptance`` fits the models.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from objconnect.localization.featuremetric.calibration_files import CalibrationFile
from objconnect.localization.featuremetric.evidence import Evidence
from objconnect.scene.config import Config
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Status

RIGHT_M: Final = 5.0
"""Largest position error of a right pose, metres."""
RIGHT_DEG: Final = 10.0
"""Largest rotation error of a right pose, degrees."""
# Log odds are clipped to this absolute value, because the calibration data do not go beyond it.
_MAX_LOG_ODDS: Final = 20.0


class AlignedModel(Config):
    """Logistic regression of aligned poses: the weights of ``Evidence.terms``."""

    bias: float = Field(description="Log odds where all terms are zero.")
    peak: float = Field(description="Weight of the logarithm of the peak-to-sidelobe ratio.")
    halves: float = Field(
        description="Weight of the logarithm of the distance between the poses of two halves of "
        "the picture."
    )
    curvature: float = Field(description="Weight of the logarithm of the curvature of the cost.")


class MatchedModel(Config):
    """Logistic regression of poses from matches, on the number of inliers."""

    bias: float = Field(description="Log odds of a pose with one inlier.")
    inliers: float = Field(description="Weight of the logarithm of the number of inliers.")


class AcceptanceModel(CalibrationFile):
    """The models of one network. ``python -m experiments.acceptance`` fits them."""

    kind = "acceptance"

    aligned: AlignedModel = Field(description="Model of aligned poses.")
    matched: MatchedModel = Field(description="Model of poses from keypoint matches.")

    def alignment_log_odds(self, evidence: Evidence) -> float:
        """Return the log odds of an aligned pose."""
        model = self.aligned
        terms = evidence.terms()
        weights = (model.peak, model.halves, model.curvature)
        return _clip_log_odds(model.bias + sum(w * x for w, x in zip(weights, terms, strict=True)))

    def match_log_odds(self, inliers: int) -> float:
        """Return the log odds of a pose from matches; minus infinity without an inlier."""
        if inliers < 1:
            return -math.inf
        return _clip_log_odds(self.matched.bias + self.matched.inliers * math.log(inliers))

    def rate(self, matched: Estimate) -> Estimate:
        """Return a pose from matches with the probability that it is right.

        It is the probability of the place, times that of an error below ``RIGHT_M`` in the right
        place. The regression sees the inliers alone, but many inliers may lie close together.
        """
        if matched.status is not Status.OK:
            return matched
        place = _probability(self.match_log_odds(matched.inliers))
        return replace(matched, probability=place * _share_within(RIGHT_M, matched.covariance))


def log_odds_of(probability: float | None) -> float:
    """Return the log odds of a probability; minus infinity for None or 0."""
    if not probability:
        return -math.inf
    return _clip_log_odds(math.log(probability) - math.log1p(-min(probability, 1 - 1e-12)))


def _share_within(metres: float, covariance: NDArray[np.float64] | None) -> float:
    """Return the probability of a position error below ``metres``; 1 without a covariance.

    The error is taken along one axis, because one axis usually has most of the variance.
    """
    if covariance is None:
        return 1.0
    variance = float(np.trace(covariance[3:, 3:]))
    return math.erf(metres / math.sqrt(2 * variance)) if variance > 0 else 1.0


def _probability(log_odds: float) -> float:
    return 1 / (1 + math.exp(-log_odds))


def _clip_log_odds(log_odds: float) -> float:
    return min(max(log_odds, -_MAX_LOG_ODDS), _MAX_LOG_ODDS)


def best_probability(
    poses: Sequence[tuple[Pose, float]], rivals: Sequence[tuple[Pose, float]] = ()
) -> tuple[int, float]:
    """Return the index of the likeliest pose, and the probability that it is right.

    At most one position is right, so two equally likely ones have a probability of at most a half
    each. If ``is_same_pose`` is true for several poses, only the likeliest of them is used.

    Args:
        poses: poses with their log odds; at least one.
        rivals: further poses with their log odds, which lower the probability but cannot be chosen.
    """
    best = max(range(len(poses)), key=lambda k: poses[k][1])
    pose, best_log_odds = poses[best]
    if best_log_odds == -math.inf:
        return best, 0.0
    distinct = [pose]
    total = 1.0 + math.exp(best_log_odds)
    for other, log_odds in sorted([*poses, *rivals], key=lambda each: -each[1]):
        if log_odds > -math.inf and not any(is_same_pose(other, each) for each in distinct):
            distinct.append(other)
            total += math.exp(log_odds)
    return best, math.exp(best_log_odds) / total


def is_same_pose(pose: Pose, other: Pose) -> bool:
    """Return whether two poses are within 5 m and 10 degrees of each other."""
    metres, degrees = (float(part) for part in pose.error_to(other))
    return metres < RIGHT_M and degrees < RIGHT_DEG
