"""Alignment from many starts: a grid of poses around the prior, compared on the coarsest level.

Alignment on a level converges from one or two cells, 30 pixels on the coarsest; a prior of 10 m and
10 degrees is off by a hundred. Rotating the camera and moving it sideways shift the picture alike,
so a grid over three parameters (two shifts and one rotation of the picture) covers all such poses.
The best of them are refined.
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
from objconnect.localization.align.local_frame import Local
from objconnect.localization.align.options import WIDTH, SearchRadius, Width
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import Level, robust_cost
from objconnect.localization.align.sampling import per_axis
from objconnect.localization.align.trees import tree_map
from objconnect.scene.geometry.pose import Pose

# Spacing of the shifts of the picture, cells of the coarsest level: the reach of an alignment.
_SPACING_CELLS: Final = 1.7
# Spacing of the rotations about the optical axis, which move the picture's corners as far.
_TURN_SPACING_DEG: Final = 6.0
# Maximum number of shifts along either axis of the picture, which bounds time.
_MAX_SHIFTS: Final = 17
# Factor on the joint shift by errors of position and attitude, whose directions may differ.
_SHIFT_MARGIN: Final = 1.2
# Largest rotation about the optical axis as a share of the radius: errors have two more axes.
_TURN_SHARE: Final = 0.6
# Steps after which hypotheses that have converged to one pose are merged.
_MERGE_ITERATIONS: Final = 4
# Factor on the step lengths at which the coarsest level ends; finer levels follow.
_ROUGH_CONVERGENCE: Final = 8.0
# Mean distance of projected points (cells) below which poses are the same.
_SAME_POSE_CELLS: Final = 0.5
# Number of cells for the mean cost by chance.
_CHANCE_CELLS: Final = 256


def around(start: Pose, distance: Tensor, radius: SearchRadius, spacing_deg: float) -> Pose:
    """Return poses (B, K) on a grid around starts (B), which are in its middle.

    Args:
        start: ``cam_from_world`` (B).
        distance: (B,) metres to the points.
        radius: extent of the grid.
        spacing_deg: degrees between neighbouring shifts of the picture.
    """
    turn = math.radians(radius.degrees)
    aside = torch.atan(radius.metres / distance.double())
    # Errors of position and attitude are independent, and both shift the picture.
    shift = _SHIFT_MARGIN * torch.hypot(aside, torch.full_like(aside, turn))
    steps = math.ceil(math.degrees(float(shift.max())) / spacing_deg)
    shifts = min(2 * steps + 1, _MAX_SHIFTS)
    heading = _TURN_SHARE * radius.degrees
    yaws = 2 * math.ceil(heading / _TURN_SPACING_DEG) + 1
    ranged = partial(torch.linspace, -1, 1, dtype=torch.float64, device=distance.device)
    unit, yaw = ranged(shifts), math.radians(heading) * ranged(yaws)
    x, y, z = (t.flatten() for t in torch.meshgrid(unit, unit, yaw, indexing="ij"))
    x, y = shift[:, None] * x, shift[:, None] * y
    # Share of a shift by errors of attitude; the rest is by errors of position.
    share = (turn**2 / (turn**2 + aside**2))[:, None]
    metres = (1 - share) * distance.double()[:, None]
    step = [share * x, share * y, z.expand_as(x), metres * y, -metres * x, torch.zeros_like(x)]
    grid = torch.stack(step, -1)
    start = start.to(dtype=torch.float64)
    each = tree_map(
        lambda t: t[:, None].expand(-1, grid.shape[1], *t.shape[1:]).flatten(0, 1), start
    )
    poses = apply_step(each, grid.flatten(0, 1))
    return tree_map(lambda t: t.view(*grid.shape[:2], *t.shape[1:]), poses)


def gain_over_chance(level: Level, local: Local, poses: Pose, robust_scale: float) -> Tensor:
    """Return the gain over chance (B, K) of poses (B, K) on one level.

    The cost of every point at every cell is computed once; a pose only looks it up. The gain of a
    point is its mean cost over all cells, the cost by chance, less its cost. Points out of view
    gain nothing, so that poses with few points in view are not preferred.
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
    place = 2 * xy / (per_axis(level.stride, points) * size) - 1
    place = torch.where(seen[..., None], place, 3).clamp(-3, 3)  # 3 is out of the picture
    maps = gain.view(-1, 1, height, width)
    sampled = grid_sample(maps, place.transpose(1, 2).flatten(0, 1)[:, None], align_corners=False)
    return sampled.view(B, -1, K).sum(1)


def align_from_many(problem: Problem, radius: SearchRadius, width: Width = WIDTH) -> Alignment:
    """Align queries from priors (B) that may be far off.

    The best hypotheses and the prior are refined on the coarsest level, the best of these on the
    finer levels, and the result is the one with the highest gain over chance on the finest level;
    it has failed, with a reason, where all of them failed.

    Args:
        problem: B queries with one start each, the prior.
        radius: extent of the search around the prior.
        width: numbers of hypotheses that are compared and refined.
    """
    if problem.points.shape[1] < problem.options.min_points:
        return align(problem)
    local, scale = Local.of(problem), problem.options.robust_scale
    coarsest = problem.coarsest().first_points(width.coarse_points)
    aligned, iterations = _refine_on_coarsest(coarsest, radius, width)
    if problem.levels[1:]:
        finalists = _best(aligned, coarsest.levels[0], scale, width.finalists)
        finalists = _distinct(finalists, local, problem.levels[1])
        aligned = align(problem.finer().starting_at(finalists.pose), with_covariance=False)
        iterations = iterations + aligned.iterations.sum(-1)
        failure = torch.where(finalists.has_failed, finalists.failure, aligned.failure)
        aligned = replace(aligned, failure=failure, by_level=finalists.by_level + aligned.by_level)
    last = problem.levels[-1] if problem.levels[1:] else coarsest.levels[-1]
    winner = _best(aligned, last, scale, 1)
    return replace(tree_map(lambda t: t[:, 0], winner), iterations=iterations)


def _refine_on_coarsest(
    coarsest: Problem, radius: SearchRadius, width: Width
) -> tuple[Alignment, Tensor]:
    """Refine the prior and the best hypotheses of a grid on the coarsest level.

    After a few steps, equal poses are merged. If two of the first hypotheses agree on the best
    pose, the others are not refined.

    Returns:
        Alignments (B, K), the best start first, and the steps tried for each query (B,).
    """
    level, solver, local = coarsest.levels[0], coarsest.options, Local.of(coarsest)
    grid = _grid(level, local, radius)
    gains = gain_over_chance(level, local, grid, solver.robust_scale)
    best = gains.topk(min(width.refined, gains.shape[1])).indices

    def with_prior(prior: Tensor, grid: Tensor) -> Tensor:
        picked = grid[torch.arange(len(grid), device=grid.device)[:, None], best]
        return torch.cat([prior[:, None], picked], 1)

    starts = local.in_world(tree_map(with_prior, local.start, grid))
    rough = solver.rougher(_ROUGH_CONVERGENCE)
    first_steps = min(_MERGE_ITERATIONS, solver.iterations)
    short = coarsest.with_options(replace(rough, iterations=first_steps))

    def begin(some: slice) -> Alignment:
        chosen = tree_map(lambda t: t[:, some], starts)
        return align(short.starting_at(chosen), with_covariance=False)

    def rank(begun: Alignment) -> Alignment:
        return _best(begun, level, solver.robust_scale, begun.seen.shape[1])

    first = width.first_refined
    begun = rank(begin(slice(first)))
    iterations = begun.iterations.sum(-1)
    met = _same(begun, local, level)[:, 0].sum(-1) > 1
    if starts.translation.shape[1] > first and not bool(met.all()):
        others = begin(slice(first, None))
        iterations = iterations + others.iterations.sum(-1)
        begun = rank(_concatenate(begun, others))
    begun = _distinct(begun, local, level)
    aligned = align(coarsest.starting_at(begun.pose).with_options(rough), with_covariance=False)
    return aligned, iterations + aligned.iterations.sum(-1)


def _concatenate(some: Alignment, others: Alignment) -> Alignment:
    """Return the alignments (B, K) of both."""
    return tree_map(lambda *parts: torch.cat(parts, 1), some, others)


def _grid(level: Level, local: Local, radius: SearchRadius) -> Pose:
    """Return the poses (B, K) around priors (B) that are compared on a level."""
    depth = local.start.to(dtype=local.points.dtype).transform(local.points)[..., 2]
    depth = torch.where(local.usable & (depth > 0), depth, torch.nan).nanmedian(-1).values
    focal, stride = local.intrinsics.focal, per_axis(level.stride, local.points)
    spacing = torch.rad2deg(torch.atan(_SPACING_CELLS * (stride / focal).min()))
    return around(local.start, depth.nan_to_num(1.0), radius, float(spacing))


def _best(aligned: Alignment, level: Level, robust_scale: float, count: int) -> Alignment:
    """Keep, per query, the ``count`` alignments (B, K) with the highest gain over chance.

    Failures come last, and of equal ones the first comes first.
    """
    chance = _cost_by_chance(level, robust_scale)
    gain = aligned.seen * (chance[:, None] - aligned.cost)
    gain = torch.where(aligned.has_failed, -torch.inf, gain)
    kept = gain.argsort(dim=1, descending=True, stable=True)[:, :count]
    query = torch.arange(len(kept), device=kept.device)[:, None]
    return tree_map(lambda t: t[query, kept], aligned)


def _distinct(aligned: Alignment, local: Local, level: Level) -> Alignment:
    """Drop alignments (B, K), best first, that have the pose of a better one.

    All queries keep as many as the one with most distinct poses.
    """
    same = _same(aligned, local, level)
    kept = torch.ones_like(same[..., 0])
    for k in range(1, kept.shape[1]):
        kept[:, k] = ~(same[:, k, :k] & kept[:, :k]).any(-1)
    order = kept.long().argsort(dim=1, descending=True, stable=True)
    order = order[:, : int(kept.sum(-1).max())]
    query = torch.arange(len(order), device=order.device)[:, None]
    return tree_map(lambda t: t[query, order], aligned)


def _same(aligned: Alignment, local: Local, level: Level) -> Tensor:
    """Return whether pairs of alignments (B, K) project the points to the same cells, (B, K, K).

    Distances are in cells of ``level``, on which the alignments continue.
    """
    xy, seen = _project(local, local.from_world(aligned.pose))
    cells = torch.where(seen[..., None], xy, 0) / per_axis(level.stride, xy)
    both = seen[:, :, None] & seen[:, None]
    apart = ((cells[:, :, None] - cells[:, None]).norm(dim=-1) * both).sum(-1) / both.sum(-1)
    # NaN, hence not the same, if no point is in view of both.
    same: Tensor = apart < _SAME_POSE_CELLS
    return same


def _project(local: Local, poses: Pose) -> tuple[Tensor, Tensor]:
    """Project the points at poses (B, K) to pixels (B, K, N, 2), with their validity (B, K, N)."""
    points, intrinsics = local.points, local.intrinsics
    own = intrinsics.focal.ndim > 1
    cameras = tree_map(lambda t: t[:, None], intrinsics) if own else intrinsics
    projected = cameras.project(poses.to(dtype=points.dtype).transform(points[:, None]))
    return projected.xy, projected.valid & local.usable[:, None]


def _cost_by_chance(level: Level, robust_scale: float) -> Tensor:
    """Return the mean cost (B,) of points at arbitrary cells."""
    cells = level.features.flatten(2)
    some = slice(None, None, max(1, cells.shape[-1] // _CHANCE_CELLS))
    cost = _costs(cells[..., some], level.reference, robust_scale).mean(-2)
    if level.confidence is None:
        return cost.mean(-1)
    # Only cells that show the photograph count.
    shown = (level.confidence.flatten(1)[:, some] > 0).to(cost)
    return (cost * shown).sum(-1) / shown.sum(-1).clamp_min(1)


def _costs(cells: Tensor, reference: Tensor, robust_scale: float) -> Tensor:
    """Return the robust cost (B, N, n) of points (B, N, C) at cells (B, C, n)."""
    cells, reference = cells.float(), reference.float()
    squares = (reference**2).sum(-1)[..., None] + (cells**2).sum(1)[:, None]
    return robust_cost((squares - 2 * reference @ cells).clamp_min(0), robust_scale)
