"""The cost of a pose, its gradient and its Gauss-Newton Hessian."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from baselines.align.sampling import CellTable, Stride, inside, per_axis, stencil, to_cells
from baselines.align.trees import rows as rows_of
from scene.pose import Pose
from scene.projection import Intrinsics


@dataclass(frozen=True)
class Level:
    """One scale of a batch of B queries, and of the N points they are aligned to.

    Attributes:
        features: (B, C, h, w) query features; cells outside the picture (padding) cut off.
            Channels-last in memory is fastest; bfloat16 is fine.
        stride: pixels of the query's camera per cell.
        reference: (B, N, C) features of the points.
        confidence: (B, 1, h, w) of the query's cells, or None.
        reference_confidence: (B, N) of the points, or None.
    """

    features: Tensor
    stride: Stride
    reference: Tensor
    confidence: Tensor | None = None
    reference_confidence: Tensor | None = None


def robust_cost(squared: Tensor, scale: float) -> Tensor:
    """Cost of squared residuals: quadratic below ``scale``, logarithmic above.

    Barron's general loss (CVPR 2019) at shape 0, times the squared scale.
    """
    return 2 * scale**2 * torch.log1p(squared / (2 * scale**2))


def robust_weight(squared: Tensor, scale: float) -> Tensor:
    """Derivative of ``robust_cost`` by the squared residual, in (0, 1]."""
    return 1 / (1 + squared / (2 * scale**2))


@dataclass(frozen=True)
class Linearisation:
    """A cost around M poses, as seen by N points each.

    Attributes:
        seen: (M, N) points that count.
        weight: (M, N) their confidence, zero where not seen.
        cost: (M, N) robust, without confidence.
        pull: (M, N, 6) gradient of each point's cost (half of it), weighted.
        hessian: (M, 6, 6) Gauss-Newton, weighted.
    """

    seen: Tensor
    weight: Tensor
    cost: Tensor
    pull: Tensor
    hessian: Tensor

    @property
    def gradient(self) -> Tensor:
        """Of half the summed cost by the tangent of the pose, (M, 6)."""
        return self.pull.sum(-2)

    def mean_cost(self) -> Tensor:
        """Confidence-weighted mean over the points seen, (M,); infinite where there are none."""
        total = self.weight.sum(-1)
        mean = (self.weight * self.cost).sum(-1) / total
        return torch.where(total > 0, mean, torch.inf)


@dataclass(frozen=True)
class Problem:
    """One level made ready to be linearised at many poses.

    Attributes:
        level: the scale.
        table: its features.
        trust: its confidence, or None.
        points: (B, N, 3).
        mask: (B, N) points to use.
        intrinsics: of the queries, batched (B) or one camera.
        border: cells at the edge of the map in which points do not count; at least 1.
        scale: of the robust cost.
    """

    level: Level
    table: CellTable
    trust: CellTable | None
    points: Tensor
    mask: Tensor
    intrinsics: Intrinsics
    border: float
    scale: float

    @staticmethod
    def of(
        level: Level,
        points: Tensor,
        mask: Tensor,
        intrinsics: Intrinsics,
        border: float,
        scale: float,
    ) -> Problem:
        """Lay out the maps of a level."""
        trust = None if level.confidence is None else CellTable.of(level.confidence)
        table = CellTable.of(level.features)
        return Problem(level, table, trust, points, mask, intrinsics, max(border, 1.0), scale)

    def linearise(self, cam_from_world: Pose, owner: Tensor) -> Linearisation:
        """Around poses (M), the m-th of query ``owner[m]``."""
        in_camera = cam_from_world.to(dtype=self.points.dtype).transform(self.points[owner])
        own = self.intrinsics.focal.ndim > 1
        cameras = rows_of(self.intrinsics, owner) if own else self.intrinsics
        projected = cameras.project(in_camera, jacobian=True)
        assert projected.jacobian is not None
        cells = to_cells(projected.xy, self.level.stride)
        seen = projected.valid & self.mask[owner]
        seen = seen & inside(cells, self.table.width, self.table.height, self.border)
        index, weights = stencil(torch.where(seen[..., None], cells, 1), owner, self.table)

        # Residual and slopes of all channels, 3 x C per point; then only their products, 3 x 3.
        reference = self.level.reference[owner]
        rows = self.table.gather(index).flatten(0, 1)
        target = torch.nn.functional.pad(-reference.to(rows.dtype)[..., None, :], (0, 0, 0, 2))
        field = torch.baddbmm(target.flatten(0, 1), weights.to(rows.dtype).flatten(0, 1), rows)
        gram = (field @ field.transpose(-1, -2)).view(*seen.shape, 3, 3).to(cells.dtype)
        squared, pull, slopes = gram[..., 0, 0], gram[..., 1:, :1], gram[..., 1:, 1:]

        trust = seen.to(cells.dtype)
        if self.trust is not None:
            trust = trust * (self.trust.gather(index)[..., 0] * weights[..., 0, :]).sum(-1)
        if self.level.reference_confidence is not None:
            trust = trust * self.level.reference_confidence[owner]
        weight = (trust * robust_weight(squared, self.scale))[..., None, None]

        jacobian = projected.jacobian / per_axis(self.level.stride, cells)[:, None]
        turn = torch.linalg.cross(in_camera[..., None, :].expand_as(jacobian), jacobian)
        jacobian = torch.cat([turn, jacobian], -1)  # (M, N, 2, 6)
        tall = jacobian.flatten(1, 2)
        return Linearisation(
            seen=seen,
            weight=trust,
            cost=robust_cost(squared, self.scale),
            pull=(weight * pull * jacobian).sum(-2),
            hessian=tall.transpose(-1, -2) @ (weight * slopes @ jacobian).flatten(1, 2),
        )
