"""Alignment from many initial poses: a grid around the prior, compared on the coarsest level.

Alignment on a level of the feature maps converges if the initial pose is off by at most one or two
cells: 30 pixels on the coarsest level. A prior that is off by 10 m and 10 degrees is off by a
hundred pixels. Rotating the camera and moving it sideways shift the picture alike, so a grid over
three parameters (two shifts and one rotation of the picture) covers all such poses. The best of
them are refined.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Final

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from objconnect.localization.align.aligner import Alignment, align
from objconnect.localization.align.damping import apply_step
from objconnect.localization.align.local_frame import LocalProblem
from objconnect.localization.align.options import SEARCH_WIDTH, SearchRadius, SearchWidth
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import Level, robust_cost
from objconnect.localization.align.sampling import per_axis
from objconnect.localization.align.trees import tree_map
from objconnect.scene.geometry.pose import Pose

# Spacing of the shifts of the picture, cells of the coarsest level. An alignment converges over
# that distance.
_SPACING_CELLS: Final = 1.7
# Spacing of the rotations about the optical axis. One such step moves the corners of the picture
# about as far as one step of the shifts.
_ROLL_SPACING_DEG: Final = 6.0
# Maximum number of shifts along either axis of the picture, which bounds time.
_MAX_SHIFTS: Final = 17
# Safety factor on the shift of the picture that errors of position and attitude cause together.
_SHIFT_MARGIN: Final = 1.2
# Largest rotation about the optical axis as a share of ``radius.degrees``, because the error of the
# attitude is spread over three axes.
_ROLL_SHARE: Final = 0.6
# Steps after which hypotheses that have converged to one pose are merged.
_MERGE_ITERATIONS: Final = 4
# The convergence thresholds of the coarsest level are multiplied by this, because finer levels
# follow.
_ROUGH_CONVERGENCE: Final = 8.0
# Mean distance of projected points (cells) below which poses are the same.
_SAME_POSE_CELLS: Final = 0.5
# Minimum number of cells over which the cost by chance is averaged, if the picture has that many;
# at most twice as many are used.
_CHANCE_CELLS: Final = 256


def grid_around(start: Pose, distance: Tensor, radius: SearchRadius, spacing_deg: float) -> Pose:
    """Return poses (B, K) on grids around starts (B); each start is in the middle of its grid.

    Args:
        start: ``cam_from_world`` (B).
        distance: (B,) metres to the points.
        radius: extent of the grid.
        spacing_deg: degrees between neighbouring shifts of the picture.
    """
    attitude_error = math.radians(radius.degrees)
    position_error = torch.atan(radius.metres / distance.double())
    # Errors of position and attitude are independent, and both shift the picture.
    shift = _SHIFT_MARGIN * torch.hypot(
        position_error, torch.full_like(position_error, attitude_error)
    )
    steps = math.ceil(math.degrees(float(shift.max())) / spacing_deg)
    shifts = min(2 * steps + 1, _MAX_SHIFTS)
    largest_roll = _ROLL_SHARE * radius.degrees
    rolls = 2 * math.ceil(largest_roll / _ROLL_SPACING_DEG) + 1
    interval = partial(torch.linspace, -1, 1, dtype=torch.float64, device=distance.device)
    unit, roll = interval(shifts), math.radians(largest_roll) * interval(rolls)
    x, y, z = (t.flatten() for t in torch.meshgrid(unit, unit, roll, indexing="ij"))
    x, y = shift[:, None] * x, shift[:, None] * y
    # Share of a shift that errors of attitude cause. Errors of position cause the rest.
    share = (attitude_error**2 / (attitude_error**2 + position_error**2))[:, None]
    metres = (1 - share) * distance.double()[:, None]
    step = [share * x, share * y, z.expand_as(x), metres * y, -metres * x, torch.zeros_like(x)]
    grid = torch.stack(step, -1)
    start = start.to(dtype=torch.float64)
    repeated = tree_map(
        lambda t: t[:, None].expand(-1, grid.shape[1], *t.shape[1:]).flatten(0, 1), start
    )
    poses = apply_step(repeated, grid.flatten(0, 1))
    return tree_map(lambda t: t.view(*grid.shape[:2], *t.shape[1:]), poses)


def gain_over_chance(level: Level, local: LocalProblem, poses: Pose, robust_scale: float) -> Tensor:
    """Return the gain over chance (B, K) of poses (B, K) on one level, the sum over all points.

    The gain of a point is its mean cost over all cells (the cost by chance) less its cost at the
    cell to which it projects. The gain is 0 for points out of view, so that poses with few points
    in view are not preferred. Costs of all points at all cells are computed once for all poses.

    Args:
        level: features of the queries and their points.
        local: the points.
        poses: ``cam_from_local``.
        robust_scale: scale of the robust cost.
    """
    B, K = poses.rotation.shape[:2]
    height, width = level.features.shape[-2:]
    points = local.points
    cost = _costs(level.features.flatten(2), level.reference, robust_scale)
    gain = cost.mean(-1, keepdim=True) - cost
    if level.confidence is not None:
        gain = gain * level.confidence.flatten(2).to(gain.dtype)
    if level.reference_confidence is not None:
        gain = gain * level.reference_confidence[..., None]

    xy, seen = _project(local, poses)
    size = torch.tensor([width, height], dtype=points.dtype, device=points.device)
    grid = 2 * xy / (per_axis(level.stride, points) * size) - 1
    grid = torch.where(seen[..., None], grid, 3).clamp(-3, 3)  # 3 is out of the picture
    maps = gain.view(-1, 1, height, width)
    sampled = grid_sample(maps, grid.transpose(1, 2).flatten(0, 1)[:, None], align_corners=False)
    return sampled.view(B, -1, K).sum(1)


def align_from_many(
    problem: Problem, radius: SearchRadius, width: SearchWidth = SEARCH_WIDTH
) -> Alignment:
    """Align queries from priors (B) that may be far from the truth.

    The prior and the best hypotheses around it are refined on the coarsest level, and the best of
    the refined poses on the finer levels. The result is the pose with the highest gain over chance
    on the finest level. If all poses of a query failed, the result has failed too.

    Args:
        problem: B queries with one start each, the prior.
        radius: extent of the search around the prior.
        width: numbers of hypotheses that are compared and refined.
    """
    if problem.points.shape[1] < problem.options.min_points:
        return align(problem)
    local, scale = LocalProblem.of(problem), problem.options.robust_scale
    coarsest = problem.coarsest().first_points(width.coarse_points)
    aligned, iterations = _refine_on_coarsest(coarsest, radius, width)
    if problem.levels[1:]:
        finalists = _keep_best(aligned, coarsest.levels[0], scale, width.finalists)
        finalists = _drop_duplicates(finalists, local, problem.levels[1])
        aligned = align(problem.finer().starting_at(finalists.pose), with_covariance=False)
        iterations = iterations + aligned.iterations.sum(-1)
        failure = torch.where(finalists.has_failed, finalists.failure, aligned.failure)
        aligned = replace(
            aligned, failure=failure, level_poses=finalists.level_poses + aligned.level_poses
        )
    last = problem.levels[-1] if problem.levels[1:] else coarsest.levels[-1]
    winner = _keep_best(aligned, last, scale, 1)
    return replace(tree_map(lambda t: t[:, 0], winner), iterations=iterations)


def _refine_on_coarsest(
    coarsest: Problem, radius: SearchRadius, width: SearchWidth
) -> tuple[Alignment, Tensor]:
    """Refine the prior and the best hypotheses of a grid on the coarsest level.

    After a few steps, equal poses are merged. If two of the hypotheses that are refined first agree
    on the best pose, the other hypotheses are not refined.

    Returns:
        Alignments (B, K), the best start first, and the steps tried for each query (B,).
    """
    level, solver, local = coarsest.levels[0], coarsest.options, LocalProblem.of(coarsest)
    grid = _grid(level, local, radius)
    gains = gain_over_chance(level, local, grid, solver.robust_scale)
    best = gains.topk(min(width.refined, gains.shape[1])).indices

    def with_prior(prior: Tensor, grid: Tensor) -> Tensor:
        picked = grid[torch.arange(len(grid), device=grid.device)[:, None], best]
        return torch.cat([prior[:, None], picked], 1)

    starts = local.to_world(tree_map(with_prior, local.start, grid))
    rough = solver.loosen_convergence(_ROUGH_CONVERGENCE)
    first_steps = min(_MERGE_ITERATIONS, solver.iterations)
    short = coarsest.with_options(replace(rough, iterations=first_steps))

    def refine(rows: slice) -> Alignment:
        chosen = tree_map(lambda t: t[:, rows], starts)
        return align(short.starting_at(chosen), with_covariance=False)

    def rank(refined: Alignment) -> Alignment:
        return _keep_best(refined, level, solver.robust_scale, refined.points_in_view.shape[1])

    first = width.first_refined
    refined = rank(refine(slice(first)))
    iterations = refined.iterations.sum(-1)
    agreed = _are_same_pose(refined, local, level)[:, 0].sum(-1) > 1
    if starts.translation.shape[1] > first and not bool(agreed.all()):
        others = refine(slice(first, None))
        iterations = iterations + others.iterations.sum(-1)
        refined = rank(_concatenate(refined, others))
    refined = _drop_duplicates(refined, local, level)
    aligned = align(coarsest.starting_at(refined.pose).with_options(rough), with_covariance=False)
    return aligned, iterations + aligned.iterations.sum(-1)


def _concatenate(first: Alignment, others: Alignment) -> Alignment:
    """Return the alignments (B, K) of both."""
    return tree_map(lambda *parts: torch.cat(parts, 1), first, others)


def _grid(level: Level, local: LocalProblem, radius: SearchRadius) -> Pose:
    """Return the poses (B, K) around priors (B) that are compared on a level."""
    depth = local.start.to(dtype=local.points.dtype).transform(local.points)[..., 2]
    depth = torch.where(local.usable & (depth > 0), depth, torch.nan).nanmedian(-1).values
    focal, stride = local.intrinsics.focal, per_axis(level.stride, local.points)
    spacing = torch.rad2deg(torch.atan(_SPACING_CELLS * (stride / focal).min()))
    return grid_around(local.start, depth.nan_to_num(1.0), radius, float(spacing))


def _keep_best(aligned: Alignment, level: Level, robust_scale: float, count: int) -> Alignment:
    """Keep, per query, the ``count`` alignments (B, K) with the highest gain over chance.

    Failed alignments come last. Alignments of equal gain keep their order.
    """
    chance = _cost_by_chance(level, robust_scale)
    gain = aligned.points_in_view * (chance[:, None] - aligned.cost)
    gain = torch.where(aligned.has_failed, -torch.inf, gain)
    kept = gain.argsort(dim=1, descending=True, stable=True)[:, :count]
    query = torch.arange(len(kept), device=kept.device)[:, None]
    return tree_map(lambda t: t[query, kept], aligned)


def _drop_duplicates(aligned: Alignment, local: LocalProblem, level: Level) -> Alignment:
    """Drop alignments (B, K), best first, that have the pose of a better one.

    All queries keep as many alignments as the query with the most distinct poses, so that the
    result is a batch.
    """
    same = _are_same_pose(aligned, local, level)
    kept = torch.ones_like(same[..., 0])
    for k in range(1, kept.shape[1]):
        kept[:, k] = ~(same[:, k, :k] & kept[:, :k]).any(-1)
    order = kept.long().argsort(dim=1, descending=True, stable=True)
    order = order[:, : int(kept.sum(-1).max())]
    query = torch.arange(len(order), device=order.device)[:, None]
    return tree_map(lambda t: t[query, order], aligned)


def _are_same_pose(aligned: Alignment, local: LocalProblem, level: Level) -> Tensor:
    """Return whether pairs of alignments (B, K) project the points to the same cells, (B, K, K).

    Cells are those of ``level``, on which the alignments continue.
    """
    xy, seen = _project(local, local.from_world(aligned.pose))
    cells = torch.where(seen[..., None], xy, 0) / per_axis(level.stride, xy)
    both = seen[:, :, None] & seen[:, None]
    distance = ((cells[:, :, None] - cells[:, None]).norm(dim=-1) * both).sum(-1) / both.sum(-1)
    # If no point is in view of both poses, the distance is NaN, and the poses are not the same.
    same: Tensor = distance < _SAME_POSE_CELLS
    return same


def _project(local: LocalProblem, poses: Pose) -> tuple[Tensor, Tensor]:
    """Project the points by poses ``cam_from_local`` (B, K).

    Returns:
        Pixels (B, K, N, 2), and whether they are valid (B, K, N).
    """
    points, intrinsics = local.points, local.intrinsics
    one_per_query = intrinsics.focal.ndim > 1
    cameras = tree_map(lambda t: t[:, None], intrinsics) if one_per_query else intrinsics
    projected = cameras.project(poses.to(dtype=points.dtype).transform(points[:, None]))
    return projected.xy, projected.valid & local.usable[:, None]


def _cost_by_chance(level: Level, robust_scale: float) -> Tensor:
    """Return the mean cost (B,) of all points over cells spread over the picture."""
    cells = level.features.flatten(2)
    sampled = slice(None, None, max(1, cells.shape[-1] // _CHANCE_CELLS))
    cost = _costs(cells[..., sampled], level.reference, robust_scale).mean(-2)
    if level.confidence is None:
        return cost.mean(-1)
    # Only cells covered by the photograph are averaged.
    shown = (level.confidence.flatten(1)[:, sampled] > 0).to(cost)
    return (cost * shown).sum(-1) / shown.sum(-1).clamp_min(1)


def _costs(cells: Tensor, reference: Tensor, robust_scale: float) -> Tensor:
    """Return the robust cost (B, N, n) of points (B, N, C) at cells (B, C, n)."""
    cells, reference = cells.float(), reference.float()
    squares = (reference**2).sum(-1)[..., None] + (cells**2).sum(1)[:, None]
    return robust_cost((squares - 2 * reference @ cells).clamp_min(0), robust_scale)
