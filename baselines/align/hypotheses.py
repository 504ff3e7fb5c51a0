"""Many starts: poses all around the prior, compared on the coarsest level, the best refined.

The features of a level guide a pose over a cell or two, 30 pixels on the coarsest; a prior of 10 m
and 10 degrees is off by a hundred. Turning the camera and moving it sideways shift the picture
alike, so that three numbers (two shifts of the picture, one turn of it) reach all such poses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from baselines.align.aligner import Alignment, align
from baselines.align.damping import moved
from baselines.align.descent import Options
from baselines.align.local import Local, working_precision
from baselines.align.residuals import Level, robust_cost
from baselines.align.sampling import per_axis
from baselines.align.trees import tree_map
from scene.geometry.pose import Pose
from scene.geometry.projection import Intrinsics

# Cells of the coarsest level between neighbouring shifts of the picture, and degrees between turns.
_SPACING = 1.7
_TURN_DEGREES = 6.0
_MOST_SHIFTS = 17
# Steps after which those of the hypotheses that have met go on as one.
_TOGETHER = 4
# How much larger than others the steps are that end a hypothesis on the coarsest level.
_ROUGH = 8
# Cells of a level. Poses so near to each other end in one place on it.
_SAME_PLACE = 0.5
# Cells of the finest level from which the cost of chance is taken.
_CHANCE_CELLS = 256


@dataclass(frozen=True)
class SearchRadius:
    """How far from the prior to look, and how many poses to refine.

    Attributes:
        metres: the largest error of position to expect, in any direction.
        degrees: the largest error of attitude.
        heading: of the turn about the camera's axis, in degrees, where it is larger than that.
        refined: hypotheses that are refined beside the prior itself, on the coarsest level.
        finalists: that go on from there to the finest.
    """

    metres: float = 8.0
    degrees: float = 10.0
    heading: float = 0.0
    refined: int = 8
    finalists: int = 2


def around(start: Pose, distance: Tensor, reach: SearchRadius, spacing_degrees: float) -> Pose:
    """Poses on a grid around others, which stand in its middle: (B) -> (B, K).

    Args:
        start: ``cam_from_world`` (B).
        distance: (B,) metres to the points.
        reach: how far to look.
        spacing_degrees: between shifts of the picture.
    """
    turn = math.radians(reach.degrees)
    aside = torch.atan(reach.metres / distance.double())
    # What the errors of a prior, in directions of their own, do to the picture together.
    shift = 1.2 * torch.hypot(aside, torch.full_like(aside, turn))
    steps = math.ceil(math.degrees(float(shift.max())) / spacing_degrees)
    shifts = min(2 * steps + 1, _MOST_SHIFTS)
    heading = max(0.6 * reach.degrees, reach.heading)
    yaws = 2 * math.ceil(heading / _TURN_DEGREES) + 1
    ranged = partial(torch.linspace, -1, 1, dtype=torch.float64, device=distance.device)
    unit, yaw = ranged(shifts), math.radians(heading) * ranged(yaws)
    x, y, z = (t.flatten() for t in torch.meshgrid(unit, unit, yaw, indexing="ij"))
    x, y = shift[:, None] * x, shift[:, None] * y
    # The share of a shift that errors of attitude have, the rest being the position's.
    share = (turn**2 / (turn**2 + aside**2))[:, None]
    metres = (1 - share) * distance.double()[:, None]
    step = [share * x, share * y, z.expand_as(x), metres * y, -metres * x, torch.zeros_like(x)]
    grid = torch.stack(step, -1)
    start = start.to(dtype=torch.float64)
    each = tree_map(
        lambda t: t[:, None].expand(-1, grid.shape[1], *t.shape[1:]).flatten(0, 1), start
    )
    reached = moved(each, grid.flatten(0, 1))
    return tree_map(lambda t: t.view(*grid.shape[:2], *t.shape[1:]), reached)


def gain(level: Level, local: Local, poses: Pose, scale: float) -> Tensor:
    """How much better than chance the points fit at poses (B, K), on one level: (B, K).

    The cost of every point at every cell is computed once; a pose only looks it up. From it the
    point's mean cost over all cells is taken, what it costs at a place taken at random: points out
    of view gain nothing, instead of making poses cheap that see few.
    """
    B, K = poses.rotation.shape[:2]
    height, width = level.features.shape[-2:]
    points = local.points
    cost = _costs(level.features.flatten(2), level.reference, scale)
    won = cost.mean(-1, keepdim=True) - cost
    if level.confidence is not None:
        won = won * level.confidence.flatten(2).to(won.dtype)
    if level.reference_confidence is not None:
        won = won * level.reference_confidence[..., None]

    xy, seen = _projected(local, poses)
    size = torch.tensor([width, height], dtype=points.dtype, device=points.device)
    place = 2 * xy / (per_axis(level.stride, points) * size) - 1
    place = torch.where(seen[..., None], place, 3).clamp(-3, 3)  # 3 is out of the picture
    maps = won.view(-1, 1, height, width)
    there = grid_sample(maps, place.transpose(1, 2).flatten(0, 1)[:, None], align_corners=False)
    return there.view(B, -1, K).sum(1)


def align_from_many(
    levels: Sequence[Level],
    points: Tensor,
    intrinsics: Intrinsics,
    start: Pose,
    damping: Sequence[Tensor],
    options: Options,
    reach: SearchRadius,
    mask: Tensor | None = None,
) -> Alignment:
    """As ``align``, from priors (B) that may be far off.

    Refines the best hypotheses and the prior on the coarsest level, the best of these on the
    others, and answers with the one that gains most over chance on the finest; with a failure
    where all fail.
    """
    if points.shape[1] < options.least_points:
        return align(levels, points, intrinsics, start, damping, options, mask)
    local = Local.of(points, intrinsics, start, mask, working_precision(levels))
    poses = _grid(levels[0], local, reach)
    gains = gain(levels[0], local, poses, options.scale)
    best = gains.topk(min(reach.refined, gains.shape[1])).indices

    def with_prior(prior: Tensor, grid: Tensor) -> Tensor:
        picked = grid[torch.arange(len(grid), device=grid.device)[:, None], best]
        return torch.cat([prior[:, None], picked], 1)

    starts = local.in_world(tree_map(with_prior, local.start, poses))
    rough = replace(
        options,
        small_metres=_ROUGH * options.small_metres,
        small_degrees=_ROUGH * options.small_degrees,
    )
    short = replace(rough, iterations=min(_TOGETHER, options.iterations))
    begun = align(levels[:1], points, intrinsics, starts, damping[:1], short, mask)
    iterations = begun.iterations.sum(-1)
    begun = _best(begun, levels[0], options.scale, starts.translation.shape[1])
    begun = _distinct(begun, local, levels[0])
    found = align(levels[:1], points, intrinsics, begun.pose, damping[:1], rough, mask)
    iterations = iterations + found.iterations.sum(-1)
    if levels[1:]:
        begun = _best(found, levels[0], options.scale, reach.finalists)
        begun = _distinct(begun, local, levels[1])
        found = align(levels[1:], points, intrinsics, begun.pose, damping[1:], options, mask)
        iterations = iterations + found.iterations.sum(-1)
        failure = torch.where(begun.failed, begun.failure, found.failure)
        found = replace(found, failure=failure, by_level=begun.by_level + found.by_level)
    winner = tree_map(lambda t: t[:, 0], _best(found, levels[-1], options.scale, 1))
    return replace(winner, iterations=iterations)


def promise(
    level: Level,
    points: Tensor,
    intrinsics: Intrinsics,
    start: Pose,
    options: Options,
    reach: SearchRadius,
) -> Tensor:
    """The most that any pose around priors (B) gains over chance on a level, (B).

    It tells near which of several priors the image is before any is refined.
    """
    local = Local.of(points, intrinsics, start, None, working_precision([level]))
    return gain(level, local, _grid(level, local, reach), options.scale).max(-1).values


def _grid(level: Level, local: Local, reach: SearchRadius) -> Pose:
    """The poses (B, K) around priors (B) that are compared on a level."""
    depth = local.start.to(dtype=local.points.dtype).transform(local.points)[..., 2]
    depth = torch.where(local.usable & (depth > 0), depth, torch.nan).nanmedian(-1).values
    focal, stride = local.intrinsics.focal, per_axis(level.stride, local.points)
    spacing = torch.rad2deg(torch.atan(_SPACING * (stride / focal).min()))
    return around(local.start, depth.nan_to_num(1.0), reach, float(spacing))


def _best(found: Alignment, level: Level, scale: float, count: int) -> Alignment:
    """Of alignments (B, K) that ended on a level the ``count`` that gain most over chance on it.

    Failures come last, and the first of the K before others that are no better.
    """
    won = found.seen * (_chance(level, scale)[:, None] - found.cost)
    won = torch.where(found.failed, -torch.inf, won)
    kept = won.argsort(dim=1, descending=True, stable=True)[:, :count]
    query = torch.arange(len(kept), device=kept.device)[:, None]
    return tree_map(lambda t: t[query, kept], found)


def _distinct(found: Alignment, local: Local, level: Level) -> Alignment:
    """Of alignments (B, K), the best first, those that show the points elsewhere than the ones
    before them, in cells of the level that they go on to.

    As many are left of every query as of the one with most.
    """
    xy, seen = _projected(local, local.moved(found.pose))
    cells = torch.where(seen[..., None], xy, 0) / per_axis(level.stride, xy)
    both = seen[:, :, None] & seen[:, None]
    apart = ((cells[:, :, None] - cells[:, None]).norm(dim=-1) * both).sum(-1) / both.sum(-1)
    same = apart < _SAME_PLACE  # not where no point is in both pictures
    kept = torch.ones_like(same[..., 0])
    for k in range(1, kept.shape[1]):
        kept[:, k] = ~(same[:, k, :k] & kept[:, :k]).any(-1)
    order = kept.long().argsort(dim=1, descending=True, stable=True)
    order = order[:, : int(kept.sum(-1).max())]
    query = torch.arange(len(order), device=order.device)[:, None]
    return tree_map(lambda t: t[query, order], found)


def _projected(local: Local, poses: Pose) -> tuple[Tensor, Tensor]:
    """Pixels (B, K, N, 2) of the points at poses (B, K), and whether they are any (B, K, N)."""
    points, intrinsics = local.points, local.intrinsics
    own = intrinsics.focal.ndim > 1
    cameras = tree_map(lambda t: t[:, None], intrinsics) if own else intrinsics
    projected = cameras.project(poses.to(dtype=points.dtype).transform(points[:, None]))
    return projected.xy, projected.valid & local.usable[:, None]


def _chance(level: Level, scale: float) -> Tensor:
    """Mean cost (B,) of points at places that are not theirs."""
    cells = level.features.flatten(2)
    some = cells[..., :: max(1, cells.shape[-1] // _CHANCE_CELLS)]
    return _costs(some, level.reference, scale).mean((-1, -2))


def _costs(cells: Tensor, reference: Tensor, scale: float) -> Tensor:
    """Robust cost (B, N, n) of points with features (B, N, C) at cells (B, C, n)."""
    cells, reference = cells.float(), reference.float()
    squares = (reference**2).sum(-1)[..., None] + (cells**2).sum(1)[:, None]
    return robust_cost((squares - 2 * reference @ cells).clamp_min(0), scale)
