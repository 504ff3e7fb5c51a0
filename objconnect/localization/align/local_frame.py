"""Points and poses relative to the starting position of each query."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from objconnect.localization.align.options import Options
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import Level, LevelCost
from objconnect.localization.align.trees import choose, tree_map
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.projection import Intrinsics


@dataclass(frozen=True)
class LocalProblem:
    """Points and initial poses relative to an origin of each query, to keep coordinates precise.

    Attributes:
        points: points (B, N, 3), metres from the origin of each query; zero where not usable.
        usable: (B, N) bool, whether points are finite and in the mask.
        intrinsics: intrinsics in the precision of the points.
        origin: position (B, 3) of the first initial pose of each query, world metres.
        start: initial ``cam_from_local``, batch shape (B,) or (B, K), float64; the identity
            replaces poses that are not finite.
        finite: whether each initial pose was finite, shape (B,) or (B, K).
    """

    points: Tensor
    usable: Tensor
    intrinsics: Intrinsics
    origin: Tensor
    start: Pose
    finite: Tensor

    @staticmethod
    def of(problem: Problem) -> LocalProblem:
        """Move a problem from the world to the origin of each of its queries.

        Points are in single precision, or in double if the features are.
        """
        points = problem.points
        double = problem.levels[0].features.dtype == torch.float64
        dtype = torch.float64 if double else torch.float32
        start = problem.start.to(dtype=torch.float64)
        finite = start.matrix().isfinite().flatten(-2).all(-1)
        start = choose(finite, start, Pose.identity(device=points.device))
        origin = start.centre().detach().reshape(len(points), -1, 3)[:, 0]
        usable = points.isfinite().all(-1)
        usable = usable if problem.mask is None else usable & problem.mask
        local = torch.where(usable[..., None], points.double() - origin[:, None], 0)
        return LocalProblem(
            points=local.to(dtype),
            usable=usable,
            intrinsics=tree_map(lambda t: t.to(dtype), problem.intrinsics),
            origin=origin,
            start=_shift_poses(start, origin),
            finite=finite,
        )

    def cost(self, level: Level, options: Options) -> LevelCost:
        """Return the cost of a level for one pose ``cam_from_local`` of each query."""
        return LevelCost.of(
            level,
            self.points,
            self.usable,
            self.intrinsics,
            options.border_cells,
            options.robust_scale,
        )

    def from_world(self, cam_from_world: Pose) -> Pose:
        """Return ``cam_from_local`` of poses (B) or (B, K)."""
        return _shift_poses(cam_from_world, self.origin)

    def to_world(self, cam_from_local: Pose) -> Pose:
        """Return ``cam_from_world`` of poses (B) or (B, K)."""
        return _shift_poses(cam_from_local, -self.origin)


def _shift_poses(cam_from_world: Pose, origin: Tensor) -> Pose:
    """Return the poses (B, ...) relative to origins (B, 3)."""
    ones = [1] * (cam_from_world.translation.ndim - 2)
    origin = origin.view(len(origin), *ones, 3, 1)
    shift = (cam_from_world.rotation @ origin)[..., 0]
    return Pose(cam_from_world.rotation, cam_from_world.translation + shift)
