"""Three measures of an aligned pose that tell a right pose from a wrong one.

The cost of a pose depends on light, season and renderer. These measures depend little on them: the
peak-to-sidelobe ratio (Bolme et al., CVPR 2010) of the gain over chance, with the peak at the pose
and the sidelobes at shifts of the picture; the distance between the poses of two halves of the
picture; and the curvature of the cost around the pose. The gain over chance of a point is its mean
cost over all cells of the picture minus its cost where it projects.
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

# Bounds of the fields of ``Evidence``, beyond which the odds do not change.
_MIN_PEAK: Final = 0.1
_MIN_CURVATURE: Final = 0.03
_MIN_HALVES_CELLS: Final = 0.02
_MAX_HALVES_CELLS: Final = 20.0
# Least number of points, and of shifts, for a peak-to-sidelobe ratio.
_MIN_COUNT: Final = 10
# Maximum number of points for the peak-to-sidelobe ratio, spread over the image. It bounds the
# time.
_POINTS: Final = 256
# Spacing of the shifts in cells of the middle level, and number of shifts to either side along each
# axis. The largest shift along an axis is 24 cells.
_STEP_CELLS: Final = 3.0
_SHIFTS: Final = 8
# Shifts shorter than this (cells) belong to the peak of the pose itself.
_CORE_CELLS: Final = 4.0
# A shift is compared if at least this share of the points in view at the pose stays in the picture.
_MIN_SHARE: Final = 0.3
# Squares along each side of the checkerboard that divides the picture into two halves.
_SQUARES: Final = 6


@dataclass(frozen=True)
class Evidence:
    """Three measures of an aligned pose.

    Attributes:
        peak: peak-to-sidelobe ratio: (gain over chance at the pose - mean gain at the shifts) /
            standard deviation of the gain at the shifts; NaN if the picture is too small to be
            shifted.
        halves: median distance between the points projected by the poses of two halves of the
            picture, cells of the finest level; infinite if a half has no pose.
        curvature: curvature of the cost around the pose, as a share of Gauss-Newton's
            (``PoseUncertainty``).
    """

    peak: float
    halves: float
    curvature: float

    def terms(self) -> tuple[float, float, float]:
        """Return the terms of the logistic regression: logarithms of the fields within bounds.

        NaN is replaced by the worst value.
        """
        halves = _MAX_HALVES_CELLS if math.isnan(self.halves) else self.halves
        # With the bound as first argument, ``max`` returns it for NaN.
        return (
            math.log(max(_MIN_PEAK, self.peak)),
            math.log(min(max(halves, _MIN_HALVES_CELLS), _MAX_HALVES_CELLS)),
            math.log(max(_MIN_CURVATURE, self.curvature)),
        )


def measure_evidence(problem: Problem, pose: Pose, curvature: float) -> Evidence:
    """Compute the three measures of an aligned pose.

    Args:
        problem: the alignment problem of one image.
        pose: ``cam_from_world``, batched (1).
        curvature: curvature of the cost around the pose.
    """
    return Evidence(peak_to_sidelobe(problem, pose), _halves_distance(problem, pose), curvature)


def peak_to_sidelobe(problem: Problem, pose: Pose) -> float:
    """Return the peak-to-sidelobe ratio ``Evidence.peak`` on the middle level.

    It is 0 if too few points are in view.

    Args:
        problem: the alignment problem of one image.
        pose: ``cam_from_world``, batched (1).
    """
    few = problem.first_points(_POINTS)
    level = few.levels[len(few.levels) // 2]
    projected = few.intrinsics.project(pose.transform(few.points))
    cells = (projected.xy / per_axis(level.stride, few.points))[0].float()
    axis = _STEP_CELLS * torch.arange(-_SHIFTS, _SHIFTS + 1, device=cells.device).float()
    shifts = torch.cartesian_prod(axis, axis)
    gain, in_view = _gains_at_shifts(level, cells, projected.valid[0], shifts, problem)
    length = shifts.norm(dim=-1)
    unshifted = int(length.argmin())
    is_sidelobe = (length >= _CORE_CELLS) & (in_view >= _MIN_SHARE * in_view[unshifted])
    sidelobe = gain[is_sidelobe]
    if in_view[unshifted] < _MIN_COUNT:
        return 0.0
    if len(sidelobe) < _MIN_COUNT:
        return math.nan
    return float((gain[unshifted] - sidelobe.mean()) / sidelobe.std().clamp_min(1e-12))


def _gains_at_shifts(
    level: Level, cells: Tensor, valid: Tensor, shifts: Tensor, problem: Problem
) -> tuple[Tensor, Tensor]:
    """Return the mean gain over chance of the points at each shift (K,), and how many are in view.

    A point's cost by chance is its mean cost over all cells that show the photograph.

    Args:
        level: features of the image and of N points.
        cells: (N, 2) projections of the points in cells; the corner of the first cell is zero.
        valid: (N,) whether a point is in front of the camera.
        shifts: (K, 2) cells.
        problem: gives the scale of the robust cost.
    """
    height, width = level.features.shape[-2:]
    image, points = level.features[0].flatten(1).float(), level.reference[0].float()
    # Costs (N, cells) are computed in place, because they exceed the processor's cache.
    cost = torch.addmm((image**2).sum(0), points, image, alpha=-2)
    cost = cost.add_((points**2).sum(-1)[:, None]).clamp_min_(0)
    scale = 2 * problem.options.robust_scale**2
    cost = cost.div_(scale).log1p_().mul_(scale)  # as ``robust_cost``
    confidence = torch.ones_like(cost[0])
    if level.confidence is not None:
        confidence = level.confidence.flatten().to(cost)
    shown = (confidence > 0).to(cost)
    chance = cost @ shown / shown.sum().clamp_min(1)
    gain = cost.neg_().add_(chance[:, None]).mul_(confidence).view(-1, 1, height, width)
    at = cells[:, None] + shifts
    size = at.new_tensor([width, height])
    seen = valid[:, None] & ((at > 0.5) & (at < size - 0.5)).all(-1)
    sampled_at = torch.where(seen[..., None], 2 * at / size - 1, 3.0)  # 3 is out of the picture
    gains = grid_sample(gain, sampled_at[:, None], align_corners=False)[:, 0, 0]
    picture = confidence.view(1, 1, height, width)
    weights = grid_sample(picture, sampled_at[None], align_corners=False)[0, 0]
    if level.reference_confidence is not None:
        gains, weights = (level.reference_confidence[0] @ each for each in (gains, weights))
    else:
        gains, weights = gains.sum(0), weights.sum(0)
    return gains / weights.clamp_min(1e-12), seen.sum(0)


def _halves_distance(problem: Problem, pose: Pose) -> float:
    """Return ``Evidence.halves``, in cells.

    The halves are the black and the white squares of a checkerboard. Each half extends over the
    whole picture, and they share no square.
    """
    finest = problem.levels[-1]
    stride = per_axis(finest.stride, problem.points)
    size = stride.new_tensor(finest.features.shape[:1:-1]) * stride
    projected = problem.intrinsics.project(pose.transform(problem.points))
    seen = projected.valid & (projected.xy > 0).all(-1) & (projected.xy < size).all(-1)
    black = (projected.xy / size * _SQUARES).floor().sum(-1) % 2 == 0
    # The pose is aligned already, so that the coarsest level is not needed.
    fine = problem.finer() if len(problem.levels) > 2 else problem.select_levels(slice(-1, None))
    xy = []
    for half in (black, ~black):
        aligned = align(replace(fine.starting_at(pose), mask=seen & half), with_covariance=False)
        if aligned.has_failed[0]:
            return math.inf
        xy.append(problem.intrinsics.project(aligned.pose.transform(problem.points)).xy)
    return float((((xy[0] - xy[1]) / stride).norm(dim=-1))[seen].median())
