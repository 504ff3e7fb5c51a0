"""The cost of a pose, its gradient and its Gauss-Newton Hessian."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from objconnect.localization.align.sampling import (
    VALUE_CELLS,
    CellTable,
    Stride,
    inside,
    per_axis,
    stencil,
)
from objconnect.localization.align.trees import select
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.projection import Intrinsics, Projection


@dataclass(frozen=True)
class Level:
    """One level of a batch of B queries and of the N points they are aligned to.

    Attributes:
        features: (B, C, h, w) query features without padding. Channels-last in memory is fastest;
            bfloat16 is allowed.
        stride: pixels of the query's camera per cell.
        reference: (B, N, C) features of the points.
        confidence: confidence (B, 1, h, w) of the query's cells, or None.
        reference_confidence: confidence (B, N) of the points, or None.
    """

    features: Tensor
    stride: Stride
    reference: Tensor
    confidence: Tensor | None = None
    reference_confidence: Tensor | None = None

    def first_points(self, count: int) -> Level:
        """Return the level with the first ``count`` points of every query."""
        confidence = self.reference_confidence
        confidence = confidence if confidence is None else confidence[:, :count]
        return replace(self, reference=self.reference[:, :count], reference_confidence=confidence)


def robust_cost(squared: Tensor, scale: float) -> Tensor:
    """Return the cost of squared residuals: quadratic below ``scale``, logarithmic above.

    It is Barron's general loss (CVPR 2019) at shape 0, times the squared scale.
    """
    return 2 * scale**2 * torch.log1p(squared / (2 * scale**2))


def robust_weight(squared: Tensor, scale: float) -> Tensor:
    """Return the derivative of ``robust_cost`` by the squared residual, in (0, 1]."""
    return 1 / (1 + squared / (2 * scale**2))


@dataclass(frozen=True)
class Linearisation:
    """A cost around M poses with N points each.

    Attributes:
        seen: (M, N) whether a point is in the mask, in view and of positive confidence.
        weight: (M, N) confidence, zero where not seen.
        cost: (M, N) robust cost without confidence.
        point_gradient: (M, N, 6) weighted gradient of half of each point's cost.
        hessian: (M, 6, 6) weighted Gauss-Newton Hessian.
        cells: (M, N, 2) projections of the points in cells; the first cell's centre is zero.
    """

    seen: Tensor
    weight: Tensor
    cost: Tensor
    point_gradient: Tensor
    hessian: Tensor
    cells: Tensor

    @property
    def gradient(self) -> Tensor:
        """Return the gradient (M, 6) of half the summed cost in the tangent of the pose."""
        return self.point_gradient.sum(-2)

    def mean_cost(self) -> Tensor:
        """Return the mean cost (M,) of the visible points, weighted; infinite without points."""
        total = self.weight.sum(-1)
        mean = (self.weight * self.cost).sum(-1) / total
        return torch.where(total > 0, mean, torch.inf)


@dataclass(frozen=True)
class LevelCost:
    """The cost of one level for M poses; poses of one query share its features.

    Attributes:
        table: features of the queries.
        confidence: confidence of the queries, or None.
        first: (M,) index of the first cell of each pose's map in these tables.
        stride: (2,) pixels per cell, x and y.
        points: (M, N, 3) metres in the frame of the poses.
        mask: (M, N) points to use.
        reference: (M, N, C) features of the points.
        reference_confidence: (M, N) confidence of the points, or None.
        intrinsics: intrinsics (M) of the queries, or one camera.
        border: cells at the edge of the map in which points are ignored; at least 1.
        scale: norm of a residual above which it loses weight.
    """

    table: CellTable
    confidence: CellTable | None
    first: Tensor
    stride: Tensor
    points: Tensor
    mask: Tensor
    reference: Tensor
    reference_confidence: Tensor | None
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
    ) -> LevelCost:
        """Return the cost of a level for one pose per query.

        Args:
            level: features of B queries and their points.
            points: (B, N, 3) in the frame of the poses.
            mask: (B, N) points to use.
            intrinsics: intrinsics of the queries, batched (B), or one for all.
            border: cells at the edge of the map in which points are ignored.
            scale: norm of a residual above which it loses weight.
        """
        is_double = level.features.dtype == torch.float64
        dtype = torch.float64 if is_double else torch.float32
        table = CellTable.of(level.features.to(dtype))
        return LevelCost(
            table=table,
            confidence=None if level.confidence is None else CellTable.of(level.confidence),
            first=table.first(torch.arange(len(points), device=points.device)),
            stride=per_axis(level.stride, points),
            points=points,
            mask=mask,
            reference=level.reference.to(dtype),
            reference_confidence=level.reference_confidence,
            intrinsics=intrinsics,
            border=max(border, 1.0),
            scale=scale,
        )

    def select(self, index: Tensor) -> LevelCost:
        """Select poses by index, which may repeat a pose, or by a mask."""
        confidence, cameras = self.reference_confidence, self.intrinsics
        return replace(
            self,
            first=self.first[index],
            points=self.points[index],
            mask=self.mask[index],
            reference=self.reference[index],
            reference_confidence=None if confidence is None else confidence[index],
            intrinsics=cameras if cameras.focal.ndim == 1 else select(cameras, index),
        )

    def sample(self, cam_from_world: Pose) -> tuple[Tensor, Tensor]:
        """Return the query's features (M, N, C) at the points projected by poses (M), and their
        confidence (M, N), zero outside the image."""
        in_camera = cam_from_world.to(dtype=self.points.dtype).transform(self.points)
        cells, seen = self._cells(self.intrinsics.project(in_camera))
        index, weights = stencil(cells, self.table, self.first)
        values = self.table.value(index, weights).to(cells)
        return values, self._confidence(seen, index, weights)

    def _project(self, cam_from_world: Pose) -> tuple[Tensor, Projection]:
        """Return points in camera frames (M, N, 3), and their pixels with derivatives."""
        in_camera = cam_from_world.to(dtype=self.points.dtype).transform(self.points)
        return in_camera, self.intrinsics.project(in_camera, jacobian=True)

    def _cells(self, projected: Projection) -> tuple[Tensor, Tensor]:
        """Return projections in cells (M, N, 2), and whether points are used (M, N).

        The first cell's centre is zero.
        """
        cells = projected.xy / self.stride - 0.5
        seen = projected.valid & self.mask
        seen = seen & inside(cells, self.table.width, self.table.height, self.border)
        return torch.where(seen[..., None], cells, 1), seen

    def _confidence(self, seen: Tensor, index: Tensor, weights: Tensor) -> Tensor:
        """Return the query's confidence (M, N) at cells of ``stencil``, zero if not seen."""
        confidence = seen.to(weights)
        if self.confidence is None:
            return confidence
        corners = self.confidence.gather(index[..., :VALUE_CELLS])[..., 0]
        return confidence * (corners * weights[..., :VALUE_CELLS]).sum(-1)

    def linearise(self, cam_from_world: Pose) -> Linearisation:
        """Return the cost around poses (M), ``cam_from_world``, with its derivatives."""
        in_camera, projected = self._project(cam_from_world)
        assert projected.jacobian is not None
        cells, seen = self._cells(projected)
        index, weights = stencil(cells, self.table, self.first)

        # Residual and slopes of all channels, 3 x C per point, then their products, 3 x 3.
        residual_and_slopes = self.table.value_and_slopes(index, weights)
        residual_and_slopes[..., 0, :] -= self.reference
        gram = (residual_and_slopes @ residual_and_slopes.transpose(-1, -2)).to(cells)
        squared = gram[..., 0, 0]

        confidence = self._confidence(seen, index, weights)
        if self.reference_confidence is not None:
            confidence = confidence * self.reference_confidence
        seen = seen & (confidence > 0)

        jacobian = projected.jacobian / self.stride[:, None]
        by_rotation = torch.linalg.cross(in_camera[..., None, :].expand_as(jacobian), jacobian)
        jacobian = torch.cat([by_rotation, jacobian], -1)  # (M, N, 2, 6)
        total_weight = (confidence * robust_weight(squared, self.scale))[..., None, None]
        chained = (total_weight * gram[..., 1:]) @ jacobian  # (M, N, 3, 6)
        return Linearisation(
            seen=seen,
            weight=confidence,
            cost=robust_cost(squared, self.scale),
            point_gradient=chained[..., 0, :],
            hessian=jacobian.flatten(1, 2).transpose(-1, -2) @ chained[..., 1:, :].flatten(1, 2),
            cells=cells,
        )
