"""Featuremetric alignment of poses, coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from objconnect.localization.align.covariance import covariance
from objconnect.localization.align.descent import descend, is_finite
from objconnect.localization.align.local_frame import LocalProblem
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import Linearisation
from objconnect.localization.align.trees import tree_map
from objconnect.scene.geometry.pose import Pose

# Values of ``Alignment.failure``, and their reasons.
_ALIGNED, _BAD_START, _TOO_FEW, _NOT_FINITE = range(4)
_REASONS: Final = (
    "",
    "the starting pose is not finite",
    "too few points of the map are in view",
    "features or confidences are not finite",
)


@dataclass(frozen=True)
class Alignment:
    """The result of an alignment, with the batch shape (B) or (B, K) of the initial poses.

    Attributes:
        pose: ``cam_from_world``, float64; if alignment failed, the last pose before the failure.
        level_poses: the pose after each level, coarse to fine; the last is ``pose``.
        covariance: covariance (..., 6, 6) of the left tangent, rotation (rad) then translation (m);
            infinite on the diagonal where alignment failed, where the points do not determine the
            pose, or if ``align`` ran without covariances.
        cost: (...) mean robust cost of the points in view on the finest level; infinite where
            alignment failed.
        iterations: (...) number of steps tried, over all levels.
        points_in_view: (...) number of points in view on the last level that was reached.
        failure: (...) 0, or a number that tells why alignment failed: see ``reason``.
    """

    pose: Pose
    level_poses: tuple[Pose, ...]
    covariance: Tensor
    cost: Tensor
    iterations: Tensor
    points_in_view: Tensor
    failure: Tensor

    @property
    def has_failed(self) -> Tensor:
        """Return (...) whether alignment failed, so that the pose must not be used."""
        return self.failure != _ALIGNED

    def reason(self, *index: int) -> str:
        """Return why the alignment of one element failed; empty if it did not."""
        code = int(self.failure[index])
        return _REASONS[code] + (
            f" ({int(self.points_in_view[index])})" if code == _TOO_FEW else ""
        )


def align(problem: Problem, with_covariance: bool = True) -> Alignment:
    """Align queries to the points of a map.

    Inputs and results are in the world frame. The computation is relative to the starting position,
    so that coordinates far from the origin keep their precision. Poses and 6 x 6 systems are in
    double precision, all else in the precision of the features, at least single. The gradient of a
    level's pose does not flow back into coarser levels.

    Args:
        problem: B queries with one start each, or with K starts each.
        with_covariance: whether to compute covariances; if not, all are infinite.

    Returns:
        Poses that are finite for any input; an element that cannot be aligned has a failure.

    Examples:
        A feature map whose two channels hold the pixel's coordinates, and a camera 10 m from the
        points:

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
    local, options = LocalProblem.of(problem), problem.options
    shape = local.finite.shape
    starts_per_query = shape[1:].numel()
    points = problem.points
    owner = torch.arange(len(points), device=points.device).repeat_interleave(starts_per_query)

    def unflatten(t: Tensor) -> Tensor:
        return t.view(*shape, *t.shape[1:])

    pose = tree_map(lambda t: t.reshape(len(owner), *t.shape[len(shape) :]), local.start)
    failure = torch.where(local.finite.flatten(), _ALIGNED, _BAD_START)
    iterations, seen = torch.zeros_like(owner), torch.zeros_like(owner)
    level_poses = []
    for level, damping in zip(problem.levels, problem.damping, strict=True):
        cost = local.cost(level, options)
        cost = cost if starts_per_query == 1 else cost.select(owner)
        active = failure == _ALIGNED
        state = descend(cost, tree_map(Tensor.detach, pose), active, damping, options)
        pose, iterations = state.pose, iterations + state.iterations
        seen = torch.where(active, state.linearisation.seen.sum(-1), seen)
        outcome = torch.where(is_finite(state.linearisation), _ALIGNED, _NOT_FINITE)
        outcome = torch.where(seen < options.min_points, _TOO_FEW, outcome)
        failure = torch.where(active, outcome, failure)
        level_poses.append(local.to_world(tree_map(unflatten, pose)))
    failed = failure != _ALIGNED
    last = state.linearisation
    unknown = failed if with_covariance else torch.ones_like(failed)
    return Alignment(
        pose=level_poses[-1],
        level_poses=tuple(level_poses),
        covariance=unflatten(_covariance(last, unknown)),
        cost=unflatten(torch.where(failed, torch.inf, last.mean_cost())),
        iterations=unflatten(iterations),
        points_in_view=unflatten(seen),
        failure=unflatten(failure),
    )


def _covariance(linearisation: Linearisation, unknown: Tensor) -> Tensor:
    """Return the covariances (M, 6, 6) of poses, infinite on the diagonal where unknown (M,)."""
    infinite = torch.full((6,), torch.inf, dtype=torch.float64, device=unknown.device).diag_embed()
    if bool(unknown.all()):
        return infinite.expand(len(unknown), 6, 6)
    return torch.where(unknown[:, None, None], infinite, covariance(linearisation))
