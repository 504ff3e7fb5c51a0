"""Featuremetric alignment of poses, coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from objconnect.localization.align.covariance import covariance
from objconnect.localization.align.descent import descend, is_finite
from objconnect.localization.align.local_frame import Local
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import Linearisation
from objconnect.localization.align.trees import tree_map
from objconnect.scene.geometry.pose import Pose

_ALIGNED, _BAD_START, _TOO_FEW, _NOT_FINITE = range(4)
_WHY: Final = (
    "",
    "the starting pose is not finite",
    "too few points of the map are in view",
    "features or confidences are not finite",
)


@dataclass(frozen=True)
class Alignment:
    """The result of an alignment, with the batch shape (B) or (B, K) of the starts.

    Attributes:
        pose: ``cam_from_world``, float64; on failure, the last one before it.
        by_level: the pose after each level, coarse to fine; the last is ``pose``.
        covariance: covariance (..., 6, 6) of the left tangent, rotation (rad) then translation (m);
            infinite on the diagonal where the points do not determine it.
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
    def has_failed(self) -> Tensor:
        """Return (...) whether alignment failed, so that the pose must not be used."""
        return self.failure != _ALIGNED

    def reason(self, *index: int) -> str:
        """Return why one element failed; empty if it did not."""
        code = int(self.failure[index])
        return _WHY[code] + (f" ({int(self.seen[index])})" if code == _TOO_FEW else "")


def align(problem: Problem, with_covariance: bool = True) -> Alignment:
    """Align queries to the points of a map.

    Points and poses are relative to the starting position, so that coordinates far from the origin
    keep their precision. Poses and 6 x 6 systems are in double precision, all else in the precision
    of the features, at least single. No gradient flows from a level into the one before.

    Args:
        problem: B queries with one start each, or K.
        with_covariance: whether to compute covariances; if not, all are infinite.

    Returns:
        Finite poses whatever the input; an element that cannot be aligned has a failure.

    Example:
        A map of two channels that hold the pixel itself, seen by a camera 10 m above four points:

        >>> import torch
        >>> from objconnect.localization.align.options import Options
        >>> from objconnect.localization.align.residuals import Level
        >>> from objconnect.scene.geometry.camera import Camera
        >>> from objconnect.scene.geometry.pose import Pose
        >>> y, x = torch.meshgrid(torch.arange(32.), torch.arange(32.), indexing="ij")
        >>> features = torch.stack([x, y])[None] / 32
        >>> points = torch.tensor([[[-3., -3, 10], [3, -3, 10], [-3, 3, 10], [3, 3, 9]]])
        >>> camera = Camera("PINHOLE", 32, 32, (32.0, 32.0, 16.0, 16.0))
        >>> reference = (camera.project(points[0].double()).xy - 0.5)[None].float() / 32
        >>> start = Pose(torch.eye(3)[None], torch.tensor([[0.1, -0.1, 0.0]]))
        >>> aligned = align(
        ...     Problem(
        ...         [Level(features, 1.0, reference)], points, camera.intrinsics(), start,
        ...         [torch.full((6,), 1e-3)], Options(min_points=4, iterations=100),
        ...     )
        ... )
        >>> bool(aligned.has_failed.any())
        False
        >>> bool(aligned.pose.translation.abs().max() < 0.02)
        True
    """
    local, options = Local.of(problem), problem.options
    shape = local.finite.shape
    starts_per_query = shape[1:].numel()
    points = problem.points
    owner = torch.arange(len(points), device=points.device).repeat_interleave(starts_per_query)

    def unflatten(t: Tensor) -> Tensor:
        return t.view(*shape, *t.shape[1:])

    pose = tree_map(lambda t: t.reshape(len(owner), *t.shape[len(shape) :]), local.start)
    failure = torch.where(local.finite.flatten(), _ALIGNED, _BAD_START)
    iterations, seen = torch.zeros_like(owner), torch.zeros_like(owner)
    by_level = []
    for level, damping in zip(problem.levels, problem.damping, strict=True):
        cost = local.cost(level, options)
        cost = cost if starts_per_query == 1 else cost.rows(owner)
        alive = failure == _ALIGNED
        state = descend(cost, tree_map(Tensor.detach, pose), alive, damping, options)
        pose, iterations = state.pose, iterations + state.iterations
        seen = torch.where(alive, state.around.seen.sum(-1), seen)
        now = torch.where(is_finite(state.around), _ALIGNED, _NOT_FINITE)
        now = torch.where(seen < options.min_points, _TOO_FEW, now)
        failure = torch.where(alive, now, failure)
        by_level.append(local.in_world(tree_map(unflatten, pose)))
    failed = failure != _ALIGNED
    last = state.around
    unknown = failed if with_covariance else torch.ones_like(failed)
    return Alignment(
        pose=by_level[-1],
        by_level=tuple(by_level),
        covariance=unflatten(_covariance(last, unknown)),
        cost=unflatten(torch.where(failed, torch.inf, last.mean_cost())),
        iterations=unflatten(iterations),
        seen=unflatten(seen),
        failure=unflatten(failure),
    )


def _covariance(around: Linearisation, unknown: Tensor) -> Tensor:
    """Return the covariances (M, 6, 6) of poses, infinite on the diagonal where unknown (M,)."""
    nothing = torch.full((6,), torch.inf, dtype=torch.float64, device=unknown.device).diag_embed()
    if bool(unknown.all()):
        return nothing.expand(len(unknown), 6, 6)
    return torch.where(unknown[:, None, None], nothing, covariance(around))
