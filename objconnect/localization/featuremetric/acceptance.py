"""The probability that a pose is right, which is within 5 m and 10 degrees of the truth.

Logistic regression gives the odds of an aligned pose from three figures of the query alone
(``evidence``), and those of a pose by matches from the number of inliers. At most one position in a
map is right, so the probabilities of poses at several positions sum to at most 1.
``python -m experiments.acceptance`` fits the models.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

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
# Odds of e**20 to one stand for certainty: no calibration data reach beyond.
_MOST_LOG_ODDS: Final = 20.0


class AlignedModel(Config):
    """Logistic regression of aligned poses: the weights of ``Evidence.terms``."""

    bias: float = Field(description="Log odds where all terms are zero.")
    peak: float = Field(description="Weight of the logarithm of the peak's height.")
    halves: float = Field(
        description="Weight of the logarithm of the distance between the halves' poses."
    )
    curvature: float = Field(description="Weight of the logarithm of the curvature.")


class MatchedModel(Config):
    """Logistic regression of poses by matches, on the number of inliers."""

    bias: float = Field(description="Log odds of a pose of one inlier.")
    inliers: float = Field(description="Weight of the logarithm of the number of inliers.")


class AcceptanceModel(CalibrationFile):
    """The models of one network. ``python -m experiments.acceptance`` fits them."""

    kind = "acceptance"

    aligned: AlignedModel = Field(description="Model of aligned poses.")
    matched: MatchedModel = Field(description="Model of poses by matches.")

    def of_alignment(self, evidence: Evidence) -> float:
        """Return the log odds of an aligned pose."""
        model = self.aligned
        terms = evidence.terms()
        weights = (model.peak, model.halves, model.curvature)
        return _clip_log_odds(model.bias + sum(w * x for w, x in zip(weights, terms, strict=True)))

    def of_matches(self, inliers: int) -> float:
        """Return the log odds of a pose by matches; minus infinity without an inlier."""
        if inliers < 1:
            return -math.inf
        return _clip_log_odds(self.matched.bias + self.matched.inliers * math.log(inliers))

    def rate(self, matched: Estimate) -> Estimate:
        """Return a pose by matches with the probability that it is right."""
        if matched.status is not Status.OK:
            return matched
        return replace(matched, probability=_probability(self.of_matches(matched.inliers)))


def log_odds_of(probability: float | None) -> float:
    """Return the log odds of a probability; minus infinity for None or 0."""
    if not probability:
        return -math.inf
    return _clip_log_odds(math.log(probability) - math.log1p(-min(probability, 1 - 1e-12)))


def _probability(log_odds: float) -> float:
    return 1 / (1 + math.exp(-log_odds))


def _clip_log_odds(log_odds: float) -> float:
    return min(max(log_odds, -_MOST_LOG_ODDS), _MOST_LOG_ODDS)


def best_probability(
    poses: Sequence[tuple[Pose, float]], rivals: Sequence[tuple[Pose, float]] = ()
) -> tuple[int, float]:
    """Return the index of the likeliest pose, and the probability that it is right.

    At most one position is right, so two equally likely ones have a probability of at most a half
    each. Poses that are as near to each other as a right pose is to the truth count once.

    Args:
        poses: poses with their log odds; at least one.
        rivals: further poses with their log odds, which lower the probability but cannot be chosen.
    """
    best = max(range(len(poses)), key=lambda k: poses[k][1])
    pose, own = poses[best]
    if own == -math.inf:
        return best, 0.0
    distinct = [pose]
    total = 1.0 + math.exp(own)
    for other, log_odds in sorted([*poses, *rivals], key=lambda each: -each[1]):
        if log_odds > -math.inf and not any(is_same(other, each) for each in distinct):
            distinct.append(other)
            total += math.exp(log_odds)
    return best, math.exp(own) / total


def is_same(pose: Pose, other: Pose) -> bool:
    """Return whether two poses are as near to each other as a right pose is to the truth."""
    metres, degrees = (float(part) for part in pose.error_to(other))
    return metres < RIGHT_M and degrees < RIGHT_DEG
