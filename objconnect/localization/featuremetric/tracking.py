"""Alignment of an image of a sequence from its predicted pose.

It uses one initial pose, a few reference images, the middle of the image, and no level coarser than
the uncertainty of the prediction needs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.localization.align.aligner import Alignment, align
from objconnect.localization.align.problem import Problem
from objconnect.localization.featuremetric.attempt import (
    AlignedView,
    Attempt,
    evaluate_alignment,
    is_accepted,
)
from objconnect.localization.featuremetric.options import SearchOptions, TrackingOptions
from objconnect.localization.featuremetric.priors import pose_of
from objconnect.localization.featuremetric.problem import ProblemBuilder
from objconnect.scene.localizer import Prior, Query, Stopwatch

# Alignment starts on the finest level on which the prediction's sigma is less than this many cells.
# If there is no such level, the image is not tracked.
_REACH_CELLS: Final = 3.0
# Coarser levels use at most this many points, and their convergence thresholds are multiplied by
# this factor. The finest level recovers the lost accuracy.
_ROUGH_POINTS: Final = 512
_ROUGH_CONVERGENCE: Final = 4.0


@dataclass(frozen=True)
class Tracking:
    """Aligns images of a sequence from their predicted poses."""

    problems: ProblemBuilder
    search: SearchOptions
    options: TrackingOptions

    def __call__(
        self, query: Query, reference_rows: NDArray[np.int64], clock: Stopwatch
    ) -> Attempt | None:
        """Align an image from its prior, the predicted pose.

        The result is None if the prediction is too uncertain to start from, or if the pose fails
        the acceptance test (probability and standard deviation).

        Args:
            query: the image; its prior has a position and an attitude.
            reference_rows: rows of its reference images, best first.
            clock: sums the seconds of each stage.
        """
        prior, options = query.prior, self.options
        assert prior is not None
        start, reference_rows = pose_of(prior), reference_rows[: options.references]
        with clock.stage("features"):
            view = self.problems.warp(query, reference_rows, start, options.coarser)
            longer = max(query.camera.width, query.camera.height)
            view = view.crop_middle(math.ceil(options.side * longer * view.scale))
            maps = self.problems.features(view)
        with clock.stage("points"):
            problem = self.problems.build(view, maps, reference_rows, start, options.points)
        with clock.stage("alignment"):
            first = _first_level(problem, _prior_sigma_px(problem, prior))
            if first is None:
                return None
            aligned = AlignedView(view, problem, _align(problem, first))
            attempt = evaluate_alignment(aligned, self.search)
        return attempt if is_accepted([attempt], self.search) else None


def _prior_sigma_px(problem: Problem, prior: Prior) -> float:
    """Return the standard deviation (px) of the projections of points by a prior's pose."""
    depth = float(problem.start.transform(problem.points)[0, :, 2].median())
    metres = 0.0 if prior.position_sigma is None else float(np.max(prior.position_sigma))
    radians = math.radians(prior.attitude_sigma_deg or 0.0)
    focal = float(problem.intrinsics.focal.mean())
    return focal * (metres / depth + radians) if depth > 0 else math.inf


def _first_level(problem: Problem, prior_sigma_px: float) -> int | None:
    """Return the index of the finest level that converges from the prediction; None if none."""
    for number in reversed(range(len(problem.levels))):
        stride = problem.levels[number].stride
        if prior_sigma_px < _REACH_CELLS * float(np.max(stride)):
            return number
    return None


def _align(problem: Problem, first: int) -> Alignment:
    """Align from level ``first`` to the finest; coarser levels use few points and stop early."""
    options = problem.options
    iterations = torch.zeros(1, dtype=torch.long, device=problem.points.device)
    rough = options.loosen_convergence(_ROUGH_CONVERGENCE)
    last = len(problem.levels) - 1
    for number in range(first, last + 1):
        level = problem.select_levels(slice(number, number + 1))
        if number < last:
            level = level.first_points(_ROUGH_POINTS).with_options(rough)
        alignment = align(level, with_covariance=False)
        iterations = iterations + alignment.iterations
        if alignment.has_failed[0]:
            break
        problem = problem.starting_at(alignment.pose)
    return replace(alignment, iterations=iterations)
