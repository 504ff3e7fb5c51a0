"""Poses that the alignment led to from one start, and when one of several is believed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from baselines.align.aligner import Alignment
from baselines.align.covariance import Spread, spread
from baselines.align.problem import Problem
from baselines.featuremetric.calibration import CovarianceNumbers, calibrated
from baselines.featuremetric.options import SearchOptions
from baselines.featuremetric.problem import fit
from baselines.views import WarpedImage
from scene.geometry.pose import Pose
from scene.localizer import By, Estimate, Status, Stopwatch

_UNCLEAR: Final = "no place of the map fits the image clearly"


@dataclass(frozen=True)
class Found:
    """The pose that one start led to.

    Attributes:
        view: the warped image.
        problem: what was aligned last.
        alignment: of the view.
    """

    view: WarpedImage
    problem: Problem
    alignment: Alignment


@dataclass(frozen=True)
class Attempt:
    """The outcome of one start.

    Attributes:
        view: the warped image.
        alignment: of the view.
        spread: how far its pose may be off; None where alignment failed.
        fit: cost as a share of the cost by chance; infinite where alignment failed.
        reason: why the pose is not accepted; empty where it is.
    """

    view: WarpedImage
    alignment: Alignment
    spread: Spread | None
    fit: float
    reason: str

    @property
    def failed(self) -> bool:
        """Whether there is no pose."""
        return bool(self.alignment.failed[0])

    @property
    def pose(self) -> Pose:
        """``cam_from_world`` of the photograph."""
        return photograph_pose(self.view, self.alignment)


def judged(found: Found, options: SearchOptions) -> Attempt:
    """Measure how well the pose of an alignment fits, and how far it may be off.

    Args:
        found: what was aligned.
        options: when a pose is accepted.
    """
    view, problem, alignment = found.view, found.problem, found.alignment
    if alignment.failed[0]:
        return Attempt(view, alignment, None, math.inf, alignment.reason(0))
    of_chance, around = fit(problem, alignment.pose), spread(problem, alignment.pose)
    reason = ""
    if not of_chance < options.accept_fit:
        reason = "the image fits the map's points hardly better than it would by chance"
    elif not around.curvature[0] >= options.least_curvature:
        reason = "the image fits the map's points nearly as well at poses around"
    return Attempt(view, alignment, around, of_chance, reason)


def estimated(
    attempts: Sequence[Attempt],
    begin: Sequence[Pose],
    begun: By,
    options: SearchOptions,
    clock: Stopwatch,
) -> Estimate:
    """Return the best of some attempts; where none is accepted, the first start.

    Args:
        attempts: what was tried.
        begin: starts, ``cam_from_world``.
        begun: what gave the first of them.
        options: how covariances are calibrated.
        clock: the time that was taken.
    """
    best = min(attempts, key=lambda attempt: (bool(attempt.reason), attempt.fit))
    seen = int(best.alignment.seen)
    iterations = sum(int(each.alignment.iterations) for each in attempts)
    if best.reason:
        return Estimate(
            Status.FALLBACK,
            begin[0],
            inliers=seen,
            iterations=iterations,
            seconds=clock.seconds,
            reason=best.reason,
            by=begun,
        )
    return Estimate(
        Status.OK,
        best.pose,
        pose_covariance(best, options),
        inliers=seen,
        iterations=iterations,
        seconds=clock.seconds,
        by=By.ALIGNMENT,
    )


def is_sure(attempt: Attempt, options: SearchOptions) -> bool:
    """Return whether a pose is accepted, and its cost rises as steeply as it should around it."""
    if attempt.reason or attempt.spread is None:
        return False
    return float(attempt.spread.curvature[0]) >= options.sure_curvature


def is_found(attempt: Attempt, options: SearchOptions) -> bool:
    """Return whether a pose is believed that was looked for all over the map.

    Among many places one fits better than by chance, but the cost does not rise steeply there.
    """
    if attempt.reason:
        return False
    return attempt.fit < options.place_accept_fit or (
        attempt.fit < options.sure_accept_fit and is_sure(attempt, options)
    )


def unclear(attempt: Attempt) -> Attempt:
    """Return an attempt that is not accepted, as other places of the map may fit as well."""
    return replace(attempt, reason=attempt.reason or _UNCLEAR)


def pose_covariance(attempt: Attempt, options: SearchOptions) -> NDArray[np.float64] | None:
    """Return the covariance (6, 6) of an attempt's pose; None where the points do not tell it.

    Args:
        attempt: with its pose.
        options: how the covariance is calibrated.
    """
    if attempt.spread is None or not attempt.spread.covariance.isfinite().all():
        return None
    of_view = calibrated(attempt.spread, attempt.fit, CovarianceNumbers.of(options))
    return attempt.view.photograph_covariance(of_view[0])


def photograph_pose(view: WarpedImage, alignment: Alignment) -> Pose:
    """Return ``cam_from_world`` of the photograph of an aligned view."""
    pose = alignment.pose
    return view.photograph_pose(Pose(pose.rotation[0], pose.translation[0]))


def stayed_near(aligned: Pose, matched: Pose, options: SearchOptions) -> bool:
    """Return whether a pose aligned from matches stayed near the pose that these gave."""
    return _near(aligned, matched, options.matched_most_m, options.matched_most_deg)


def _near(pose: Pose, other: Pose, most_m: float, most_deg: float) -> bool:
    """Return whether two poses are closer than a distance (metres) and an angle (degrees)."""
    metres, degrees = (float(part) for part in pose.error_to(other))
    return metres < most_m and degrees < most_deg
