"""The outcome of an alignment from one initial pose, and the estimate from several outcomes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.localization.align.aligner import Alignment
from objconnect.localization.align.covariance import PoseUncertainty, measure_uncertainty
from objconnect.localization.align.problem import Problem
from objconnect.localization.featuremetric.acceptance import best_probability
from objconnect.localization.featuremetric.calibration import calibrate_covariance
from objconnect.localization.featuremetric.evidence import Evidence, measure_evidence
from objconnect.localization.featuremetric.options import SearchOptions
from objconnect.localization.featuremetric.problem import relative_cost
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import WarpedImage
from objconnect.scene.localizer import Estimate, PoseSource, Status, Stopwatch

Rivals = Sequence[tuple[Pose, float]]
"""Poses that no attempt gave, such as a pose from keypoint matches, with their log odds of being
right. A rival lowers the probability of the likeliest attempt if the two poses differ
(``is_same_pose``)."""


@dataclass(frozen=True)
class AlignedView:
    """A warped image, its alignment, and the alignment problem that was solved last."""

    view: WarpedImage
    problem: Problem
    alignment: Alignment


@dataclass(frozen=True)
class Attempt:
    """The outcome of an alignment from one initial pose.

    Attributes:
        view: the warped image.
        alignment: the alignment of the view.
        uncertainty: uncalibrated covariance of the view's pose; None if the alignment failed or
            ended early.
        fit: cost as a share of the cost by chance (``problem.relative_cost``); infinite if the
            alignment failed or ended early.
        evidence: measures that tell a right pose from a wrong one; None if the alignment failed or
            ended early.
        log_odds: log odds that the pose is right; minus infinity if the alignment failed or ended
            early.
    """

    view: WarpedImage
    alignment: Alignment
    uncertainty: PoseUncertainty | None
    fit: float
    evidence: Evidence | None
    log_odds: float

    @classmethod
    def without_evidence(cls, aligned: AlignedView) -> Attempt:
        """Return the outcome of an alignment that failed or ended early."""
        return cls(aligned.view, aligned.alignment, None, math.inf, None, -math.inf)

    @property
    def has_failed(self) -> bool:
        """Whether the alignment failed, so that there is no pose."""
        return bool(self.alignment.has_failed[0])

    @property
    def pose(self) -> Pose:
        """``cam_from_world`` of the photograph."""
        return photograph_pose(self.view, self.alignment)


def evaluate_alignment(aligned: AlignedView, options: SearchOptions) -> Attempt:
    """Measure the covariance, the relative cost and the log odds of an aligned pose."""
    assert options.acceptance is not None
    view, problem, alignment = aligned.view, aligned.problem, aligned.alignment
    if alignment.has_failed[0]:
        return Attempt.without_evidence(aligned)
    uncertainty = measure_uncertainty(problem, alignment.pose)
    cost_share = relative_cost(problem, alignment.pose)
    evidence = measure_evidence(problem, alignment.pose, float(uncertainty.curvature[0]))
    log_odds = options.acceptance.alignment_log_odds(evidence)
    return Attempt(view, alignment, uncertainty, cost_share, evidence, log_odds)


def select_likeliest(attempts: Sequence[Attempt], rivals: Rivals = ()) -> tuple[Attempt, float]:
    """Return the likeliest attempt, and the probability that it is right."""
    poses = [(each.pose, each.log_odds) for each in attempts]
    best, probability = best_probability(poses, rivals)
    return attempts[best], probability


def is_probable(attempts: Sequence[Attempt], options: SearchOptions, rivals: Rivals = ()) -> bool:
    """Return whether the likeliest attempt is right with a probability of at least 1 - risk."""
    best, probability = select_likeliest(attempts, rivals)
    return not best.has_failed and probability >= 1 - options.risk


def is_accepted(attempts: Sequence[Attempt], options: SearchOptions, rivals: Rivals = ()) -> bool:
    """Return whether the likeliest attempt is an answer: probable, with a small enough sigma."""
    best, probability = select_likeliest(attempts, rivals)
    return not _rejection_reason(best, probability, len(attempts), options)


def select_estimate(
    attempts: Sequence[Attempt],
    starts: Sequence[Pose],
    source: PoseSource,
    options: SearchOptions,
    clock: Stopwatch,
    rivals: Rivals = (),
) -> Estimate:
    """Return the likeliest attempt; if not accepted, the first initial pose as ``FALLBACK``.

    Args:
        attempts: outcomes of all initial poses.
        starts: initial ``cam_from_world``; at least one.
        source: source of the first initial pose.
        options: bounds of acceptance and the calibration of covariances.
        clock: time of the query so far.
        rivals: poses that no attempt gave, such as a pose from keypoint matches.
    """
    best, probability = select_likeliest(attempts, rivals)
    answer = Estimate(
        Status.OK,
        best.pose,
        pose_covariance(best, options),
        inliers=int(best.alignment.points_in_view),
        iterations=sum(int(each.alignment.iterations) for each in attempts),
        seconds=clock.seconds,
        reason=_rejection_reason(best, probability, len(attempts), options),
        by=PoseSource.ALIGNMENT,
        probability=probability,
    )
    if not answer.reason:
        return answer
    fallback = replace(answer, status=Status.FALLBACK, covariance=None, by=source)
    return replace(fallback, cam_from_world=starts[0])


def sigma_m(attempt: Attempt, options: SearchOptions) -> float:
    """Return the standard deviation of the camera's position, metres; infinite if unknown."""
    covariance = pose_covariance(attempt, options)
    return math.inf if covariance is None else math.sqrt(np.trace(covariance[3:, 3:]))


def _rejection_reason(best: Attempt, probability: float, tried: int, options: SearchOptions) -> str:
    """Return why the likeliest of ``tried`` attempts is not accepted; empty if it is."""
    if best.has_failed:
        return best.alignment.reason(0)
    pose = "the aligned pose" if tried == 1 else f"the likeliest of {tried} aligned poses"
    if probability < 1 - options.risk:
        shown = math.floor(100 * probability) / 100  # never rounded up to the bound
        return (
            f"{pose} is right with a probability of {shown:.2f}, below {1 - options.risk:g} "
            "(1 - search.risk)"
        )
    if (sigma := sigma_m(best, options)) > options.most_sigma_m:
        return (
            f"the position of {pose} has a standard deviation of {sigma:.1f} m, above "
            f"search.most_sigma_m of {options.most_sigma_m:g} m"
        )
    return ""


def pose_covariance(attempt: Attempt, options: SearchOptions) -> NDArray[np.float64] | None:
    """Return the calibrated covariance (6, 6) of an attempt's pose; None if it is not finite."""
    if attempt.uncertainty is None or not attempt.uncertainty.covariance.isfinite().all():
        return None
    assert options.covariance is not None
    view_covariance = calibrate_covariance(attempt.uncertainty, attempt.fit, options.covariance)
    return attempt.view.photograph_covariance(view_covariance[0])


def photograph_pose(view: WarpedImage, alignment: Alignment) -> Pose:
    """Return ``cam_from_world`` of the photograph of an aligned view, on the CPU."""
    pose = alignment.pose.to(device=torch.device("cpu"))
    return view.photograph_pose(Pose(pose.rotation[0], pose.translation[0]))
