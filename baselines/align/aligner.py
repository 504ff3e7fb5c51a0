"""Poses from features, coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from baselines.align.covariance import covariance
from baselines.align.descent import Options, descend, is_finite
from baselines.align.residuals import Level, Problem
from baselines.align.trees import choose, over
from scene.pose import Pose
from scene.projection import Intrinsics

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
    shape = start.rotation.shape[:-2]
    B, K = shape[0], shape[1:].numel()
    dtype = torch.float64 if levels[0].features.dtype == torch.float64 else torch.float32
    owner = torch.arange(B, device=points.device).repeat_interleave(K)

    begin = Pose(start.rotation.reshape(-1, 3, 3), start.translation.reshape(-1, 3))
    begin = begin.to(dtype=torch.float64)
    finite = begin.matrix().isfinite().flatten(1).all(-1)
    nowhere = Pose.identity().to(device=points.device)
    begin = choose(finite, begin, over(lambda t: t.expand(B * K, *t.shape), nowhere))

    origin = begin.centre().detach().view(B, K, 3)[:, 0]
    usable = points.isfinite().all(-1)
    usable = usable if mask is None else usable & mask
    local = torch.where(usable[..., None], points.double() - origin[:, None], 0).to(dtype)
    cameras = over(lambda t: t.to(dtype), intrinsics)

    pose = _about(begin, origin[owner])
    failure = torch.where(finite, _ALIGNED, _BAD_START)
    iterations = torch.zeros_like(owner)
    seen = torch.zeros_like(owner)
    by_level = []
    for level, held_back in zip(levels, damping, strict=True):
        problem = Problem.of(level, local, usable, cameras, options.border, options.scale)
        problem = problem if K == 1 else problem.rows(owner)
        before = over(Tensor.detach, pose)
        place = descend(problem, before, failure == _ALIGNED, held_back, options)
        pose, iterations = place.pose, iterations + place.iterations
        seen = torch.where(failure == _ALIGNED, place.around.seen.sum(-1), seen)
        too_few = torch.where(seen < options.least_points, _TOO_FEW, _ALIGNED)
        now = torch.where(is_finite(place.around), too_few, _NOT_FINITE)
        failure = torch.where(failure == _ALIGNED, now, failure)
        in_world = _about(pose, -origin[owner])
        by_level.append(over(lambda t: t.view(*shape, *t.shape[1:]), in_world))
    return Alignment(
        pose=by_level[-1],
        by_level=tuple(by_level),
        covariance=covariance(place.around).view(*shape, 6, 6),
        cost=place.around.mean_cost().view(shape),
        iterations=iterations.view(shape),
        seen=seen.view(shape),
        failure=failure.view(shape),
    )


def _about(cam_from_world: Pose, origin: Tensor) -> Pose:
    """The same poses for points from which ``origin`` (M, 3) was taken."""
    moved = cam_from_world.translation + (cam_from_world.rotation @ origin[..., None])[..., 0]
    return Pose(cam_from_world.rotation, moved)
