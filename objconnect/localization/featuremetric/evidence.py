"""Three figures of a query that tell a right pose from a wrong one.

The cost of a pose depends on light, season and renderer. These figures depend little on them: the
peak-to-sidelobe ratio of the gain at the pose against that of the shifted picture (Bolme et al.,
CVPR 2010), the distance between the poses of two halves of the picture, and the curvature of the
cost around the pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from objconnect.localization.align.aligner import align
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import Level
from objconnect.localization.align.sampling import per_axis
from objconnect.scene.geometry.pose import Pose

# Bounds of the figures, beyond which the odds do not change.
_LEAST_HEIGHT: Final = 0.1
_LEAST_CURVATURE: Final = 0.03
_LEAST_CELLS: Final = 0.02
_MOST_CELLS: Final = 20.0
# Least number of points, and of shifts, for a peak-to-sidelobe ratio.
_FEWEST: Final = 10
# Points that are compared, spread over the image, which bounds time.
_POINTS: Final = 256
# Cells of the middle level between neighbouring shifts, and shifts to either side along an axis:
# the picture is compared with itself up to 24 cells aside.
_STEP_CELLS: Final = 3.0
_SHIFTS: Final = 8
# Shifts shorter than this (cells) belong to the peak of the pose itself.
_CORE_CELLS: Final = 4.0
# Least share of the points that a shift leaves in the picture.
_LEAST_SHARE: Final = 0.3
# Fields along either axis of the checkerboard that halves the picture.
_FIELDS: Final = 6


@dataclass(frozen=True)
class Evidence:
    """Figures of an aligned pose.

    Attributes:
        height: peak-to-sidelobe ratio: gain over chance at the pose less the mean of shifted
            pictures, in their standard deviations.
        halves: median distance between the points projected by the poses of two halves of the
            picture, cells of the finest level; infinite if a half has no pose.
        curvature: curvature of the cost around the pose, as a share of Gauss-Newton's (``Spread``).
    """

    height: float
    halves: float
    curvature: float

    def terms(self) -> tuple[float, float, float]:
        """Return the terms of the logistic regression: logarithms of the fields within bounds.

        NaN counts as the worst value.
        """
        halves = _MOST_CELLS if math.isnan(self.halves) else self.halves
        # In this order, ``max`` drops NaN.
        return (
            math.log(max(_LEAST_HEIGHT, self.height)),
            math.log(min(max(halves, _LEAST_CELLS), _MOST_CELLS)),
            math.log(max(_LEAST_CURVATURE, self.curvature)),
        )


def measure_evidence(problem: Problem, pose: Pose, curvature: float) -> Evidence:
    """Measure the figures of an aligned pose.

    Args:
        problem: the alignment problem of one image.
        pose: ``cam_from_world``, batched (1).
        curvature: curvature of the cost around the pose.
    """
    return Evidence(_height(problem, pose), _between_halves(problem, pose), curvature)


def _height(problem: Problem, pose: Pose) -> float:
    """Return the height of the peak, as in ``Evidence``, on the middle level."""
    few = problem.first_points(_POINTS)
    level = few.levels[len(few.levels) // 2]
    projected = few.intrinsics.project(pose.transform(few.points))
    cells = (projected.xy / per_axis(level.stride, few.points))[0].float()
    side = _STEP_CELLS * torch.arange(-_SHIFTS, _SHIFTS + 1, device=cells.device).float()
    shifts = torch.cartesian_prod(side, side)
    gain, share = _gains_at_shifts(level, cells, projected.valid[0], shifts, problem)
    length = shifts.norm(dim=-1)
    here = int(length.argmin())
    aside = (length >= _CORE_CELLS) & (share >= _LEAST_SHARE * share[here])
    others = gain[aside]
    if len(others) < _FEWEST or share[here] < _FEWEST:
        return 0.0
    return float((gain[here] - others.mean()) / others.std().clamp_min(1e-12))


def _gains_at_shifts(
    level: Level, cells: Tensor, valid: Tensor, shifts: Tensor, problem: Problem
) -> tuple[Tensor, Tensor]:
    """Return mean gains over chance (K,) of all points under shifts, and how many are in view.

    A point's cost by chance is its mean cost over all cells, as in ``hypotheses.gain_over_chance``.

    Args:
        level: features of the image and of N points.
        cells: (N, 2) projections of the points in cells; the corner of the first cell is zero.
        valid: (N,) whether a point is in front of the camera.
        shifts: (K, 2) cells.
        problem: has the scale of the robust cost.
    """
    height, width = level.features.shape[-2:]
    image, points = level.features[0].flatten(1).float(), level.reference[0].float()
    # In place, because the costs of all points at all cells exceed the processor's cache.
    cost = torch.addmm((image**2).sum(0), points, image, alpha=-2)
    cost = cost.add_((points**2).sum(-1)[:, None]).clamp_min_(0)
    scale = 2 * problem.options.robust_scale**2
    cost = cost.div_(scale).log1p_().mul_(scale)  # as ``robust_cost``
    trust = torch.ones_like(cost[0])
    if level.confidence is not None:
        trust = level.confidence.flatten().to(cost)
    shown = (trust > 0).to(cost)
    chance = cost @ shown / shown.sum().clamp_min(1)
    gain = cost.neg_().add_(chance[:, None]).mul_(trust).view(-1, 1, height, width)
    at = cells[:, None] + shifts
    size = at.new_tensor([width, height])
    seen = valid[:, None] & ((at > 0.5) & (at < size - 0.5)).all(-1)
    place = torch.where(seen[..., None], 2 * at / size - 1, 3.0)  # 3 is out of the picture
    gains = grid_sample(gain, place[:, None], align_corners=False)[:, 0, 0]
    trusted = grid_sample(trust.view(1, 1, height, width), place[None], align_corners=False)[0, 0]
    if level.reference_confidence is not None:
        gains, trusted = (level.reference_confidence[0] @ each for each in (gains, trusted))
    else:
        gains, trusted = gains.sum(0), trusted.sum(0)
    return gains / trusted.clamp_min(1e-12), seen.sum(0)


def _between_halves(problem: Problem, pose: Pose) -> float:
    """Return the distance between the halves' poses, as in ``Evidence``.

    The halves are the black and the white fields of a checkerboard: both cover the whole picture,
    and no patch of it is in both.
    """
    finest = problem.levels[-1]
    stride = per_axis(finest.stride, problem.points)
    size = stride.new_tensor(finest.features.shape[:1:-1]) * stride
    projected = problem.intrinsics.project(pose.transform(problem.points))
    seen = projected.valid & (projected.xy > 0).all(-1) & (projected.xy < size).all(-1)
    black = (projected.xy / size * _FIELDS).floor().sum(-1) % 2 == 0
    begin = problem.finer() if len(problem.levels) > 2 else problem.at_levels(slice(-1, None))
    at = []
    for half in (black, ~black):
        aligned = align(replace(begin.starting_at(pose), mask=seen & half), with_covariance=False)
        if aligned.has_failed[0]:
            return math.inf
        at.append(problem.intrinsics.project(aligned.pose.transform(problem.points)).xy)
    return float((((at[0] - at[1]) / stride).norm(dim=-1))[seen].median())
