"""Poses from features, coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from baselines.align.covariance import covariance
from baselines.align.descent import Options, descend, is_finite
from baselines.align.local import Local, working_precision
from baselines.align.residuals import Level, Problem
from baselines.align.trees import tree_map
from scene.geometry.pose import Pose
from scene.geometry.projection import Intrinsics

_ALIGNED, _BAD_START, _TOO_FEW, _NOT_FINITE = range(4)
_WHY: Final = (
    "",
    "the starting pose is not finite",
    "too few points of the map are in view",
    "features or confidences are not finite",
)


@dataclass(frozen=True)
class Alignment:
    """Poses found, batched (B) or (B, K) as the starting poses were.

    Attributes:
        pose: ``cam_from_world``, float64; where alignment failed, the last one before it did.
        by_level: the pose after each level, coarse to fine; the last is ``pose``.
        covariance: (..., 6, 6) of the left tangent, rotation (rad) then translation (m); infinite
            on the diagonal where the points do not determine it.
        cost: (...) mean robust cost of the points in view on the finest level.
        iterations: (...) steps tried, over all levels.
        seen: (...) points in view on the last level reached.
        failure: (...) 0, or why alignment failed: see ``reason``.
    """

    pose: Pose
    by_level: tuple[Pose, ...]
    covariance: Tensor
    cost: Tensor
    iterations: Tensor
    seen: Tensor
    failure: Tensor

    @property
    def failed(self) -> Tensor:
        """(...) where there is no pose to trust."""
        return self.failure != _ALIGNED

    def reason(self, *index: int) -> str:
        """Why one element failed, in words; empty where it did not."""
        code = int(self.failure[index])
        return _WHY[code] + (f" ({int(self.seen[index])})" if code == _TOO_FEW else "")


def align(
    levels: Sequence[Level],
    points: Tensor,
    intrinsics: Intrinsics,
    start: Pose,
    damping: Sequence[Tensor],
    options: Options,
    mask: Tensor | None = None,
) -> Alignment:
    """Align queries to the points of a map.

    Points and poses are taken relative to the starting position, so that coordinates far from the
    origin cost no precision; poses and 6 x 6 systems are in double precision, all else in single
    (in double where the features are).

    Args:
        levels: of B queries, coarse to fine.
        points: (B, N, 3) in the world, metres.
        intrinsics: of the queries, batched (B), or one for all.
        start: ``cam_from_world``, batched (B), or (B, K) for K starts of every query, which share
            its features.
        damping: (6,) of every level, rotation then translation: see ``Damping``.
        options: how to go down. No gradient flows from a level into the one before.
        mask: (B, N) points to use, or None for all.

    Returns:
        A finite pose whatever the input: what cannot be aligned has failed, with a reason.
    """
    local = Local.of(points, intrinsics, start, mask, working_precision(levels))
    shape = local.finite.shape
    starts_per_query = shape[1:].numel()
    owner = torch.arange(len(points), device=points.device).repeat_interleave(starts_per_query)

    def unflattened(t: Tensor) -> Tensor:
        return t.view(*shape, *t.shape[1:])

    pose = tree_map(lambda t: t.reshape(len(owner), *t.shape[len(shape) :]), local.start)
    failure = torch.where(local.finite.flatten(), _ALIGNED, _BAD_START)
    iterations, seen = torch.zeros_like(owner), torch.zeros_like(owner)
    by_level = []
    for level, held_back in zip(levels, damping, strict=True):
        problem = Problem.of(
            level, local.points, local.usable, local.intrinsics, options.border, options.scale
        )
        problem = problem if starts_per_query == 1 else problem.rows(owner)
        alive = failure == _ALIGNED
        place = descend(problem, tree_map(Tensor.detach, pose), alive, held_back, options)
        pose, iterations = place.pose, iterations + place.iterations
        seen = torch.where(alive, place.around.seen.sum(-1), seen)
        now = torch.where(is_finite(place.around), _ALIGNED, _NOT_FINITE)
        now = torch.where(seen < options.least_points, _TOO_FEW, now)
        failure = torch.where(alive, now, failure)
        by_level.append(local.in_world(tree_map(unflattened, pose)))
    failed = failure != _ALIGNED
    cost = torch.where(failed, torch.inf, place.around.mean_cost())
    unknown = torch.full((6,), torch.inf, dtype=torch.float64, device=failed.device).diag_embed()
    spread = torch.where(failed[:, None, None], unknown, covariance(place.around))
    return Alignment(
        pose=by_level[-1],
        by_level=tuple(by_level),
        covariance=unflattened(spread),
        cost=unflattened(cost),
        iterations=unflattened(iterations),
        seen=unflattened(seen),
        failure=unflattened(failure),
    )
