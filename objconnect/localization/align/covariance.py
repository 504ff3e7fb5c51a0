"""Covariance of an aligned pose from its residuals and the curvature of the cost."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import torch
from torch import Tensor

from objconnect.localization.align.damping import apply_step
from objconnect.localization.align.linearise import linearise
from objconnect.localization.align.local_frame import LocalProblem
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import LevelCost, Linearisation
from objconnect.localization.align.trees import select
from objconnect.scene.geometry.pose import Pose

# Number of patches that determine a pose: a pose has six degrees of freedom, and each patch gives
# two equations.
_PATCHES_PER_POSE = 3
# Variance of the rotation (rad^2) above which the rotation is unknown.
_UNKNOWN_ROTATION = math.pi**2
# Side of the square patches, in cells of the feature map. Points in one patch are treated as
# dependent.
_PATCH_CELLS: Final = 24.0
# Share by which the scatter of the patches' gradients is shrunk to that of independent residuals.
_SHRINKAGE: Final = 0.6
# Distance from a pose, in standard deviations, at which the curvature of the cost is measured. At
# smaller distances noise of the features dominates; at larger ones the cost is not quadratic.
_CURVATURE_SIGMAS: Final = 3.6
# Lower bound of the measured curvature in any direction, as a share of Gauss-Newton's.
_MIN_CURVATURE_SHARE: Final = 0.05


def covariance(
    linearisation: Linearisation, patch_cells: float = _PATCH_CELLS, shrinkage: float = _SHRINKAGE
) -> Tensor:
    """Return the covariance (M, 6, 6) of poses at the minimum of their cost, in double precision.

    It is Huber's sandwich H^-1 S H^-1, where S is the sum of p p^T and p the gradient of each patch
    of the image. Channels of a feature and points of one patch may depend on one another (Liang and
    Zeger, Biometrika 1986, on clusters), because neighbouring points show the same things and a
    point occurs once for each reference image. S is scaled up for the degrees of freedom of the
    pose itself. The diagonal is infinite where the points do not determine a pose.

    Args:
        linearisation: the cost around the M poses.
        patch_cells: side of the patches, cells.
        shrinkage: share by which S is shrunk to that of independent residuals, 0 to 1.
    """
    scatter, count = _scatter(_grids(linearisation, patch_cells))
    return _sandwich(linearisation.hessian.detach().double(), scatter, count, shrinkage)


def _sandwich(H: Tensor, scatter: Tensor, count: Tensor, shrinkage: float = _SHRINKAGE) -> Tensor:
    """Return covariances (M, 6, 6) as ``covariance`` does.

    The scatter of few patches has too large major and too small minor axes. It is shrunk towards
    the multiple of H with the same trace in the basis in which H is the identity (Ledoit and Wolf,
    Journal of Multivariate Analysis 2004).

    Args:
        H: (M, 6, 6) second derivatives of half the summed cost. Gauss-Newton's are right where
            residuals are small.
        scatter: (M, 6, 6) as ``_scatter`` returns it.
        count: (M,) patches with points.
        shrinkage: weight of that multiple of H in the result, 0 to 1.
    """
    enough = count > _PATCHES_PER_POSE
    factor, info = torch.linalg.cholesky_ex(H)
    determined = enough & (info == 0)
    eye = torch.eye(6, dtype=H.dtype, device=H.device)
    factor = torch.where(determined[:, None, None], factor, eye)
    half = torch.linalg.solve_triangular(factor, scatter, upper=False)
    white = torch.linalg.solve_triangular(factor, half.transpose(-1, -2), upper=False)
    scatter_level = white.diagonal(dim1=-2, dim2=-1).mean(-1)[:, None, None]
    white = (1 - shrinkage) * white + shrinkage * scatter_level * eye
    upper = factor.transpose(-1, -2)
    half = torch.linalg.solve_triangular(upper, white, upper=True)
    result = torch.linalg.solve_triangular(upper, half.transpose(-1, -2), upper=True)
    rotation_variance = result.diagonal(dim1=-2, dim2=-1)[:, :3].amax(-1)
    known = determined & result.isfinite().flatten(1).all(-1)
    known &= rotation_variance < _UNKNOWN_ROTATION
    unknown = torch.full_like(H[0, 0], torch.inf).diag_embed().expand_as(H)
    return torch.where(known[:, None, None], 0.5 * (result + result.transpose(-1, -2)), unknown)


@dataclass(frozen=True)
class PoseUncertainty:
    """Uncalibrated covariances of aligned poses, and the measures that calibrate them.

    Attributes:
        covariance: (B, 6, 6) of the left tangent, rotation (rad) then translation (m); infinite on
            the diagonal where the points do not determine a pose.
        curvature: (B,) geometric mean of the curvature of the cost over six directions, as a share
            of Gauss-Newton's, at most 1; 0 where the points do not determine a pose.
        depth: (B,) median depth of the points in view, metres; zero without any.
        patches: (B,) number of patches of the image with points in view, the mean of four grids.
        view_cosine: (B,) mean cosine of the angle between the directions in which the query and the
            reference images see the points in view; 1 if the reference images are unknown.
        informative_cost_ratio: (B,) mean cost of the points, weighted by their information on the
            pose, as a share of their mean cost; 1 where the points do not determine a pose.
        scatter_level: (B,) mean over six directions of the scatter of the patches' gradients, as a
            share of the Gauss-Newton Hessian; 0 where the points do not determine a pose.
        effective_patches: (B,) effective number of patches for ``scatter_level``.
    """

    covariance: Tensor
    curvature: Tensor
    depth: Tensor
    patches: Tensor
    view_cosine: Tensor
    informative_cost_ratio: Tensor
    scatter_level: Tensor
    effective_patches: Tensor


def measure_uncertainty(problem: Problem, aligned: Pose) -> PoseUncertainty:
    """Compute the covariances of poses (B) aligned on the finest level of a problem.

    If a query differs from the map, as in snow, the Gauss-Newton Hessian is too large, because it
    includes the slopes of the features of things in the query that the map does not have.
    Therefore the second derivatives of the cost are measured by differences of gradients, along the
    axes in which that Hessian is the identity. They replace the Hessian where they are smaller.

    Args:
        problem: the alignment problem.
        aligned: ``cam_from_world`` at the minimum.
    """
    local = LocalProblem.of(problem.starting_at(aligned))
    cost = local.cost(problem.levels[-1], problem.options)
    linearisation = linearise(cost, local.start)
    depth = local.start.to(dtype=local.points.dtype).transform(local.points)[..., 2].double()
    depth = torch.where(linearisation.seen, depth, torch.nan)
    grids = _grids(linearisation, _PATCH_CELLS)
    scatter, patches = _scatter(grids)
    hessian = linearisation.hessian.detach().double()
    gauss_newton = _sandwich(hessian, scatter, patches)
    known = (local.finite & gauss_newton.isfinite().flatten(1).all(-1))[:, None, None]
    eye = torch.eye(6, dtype=gauss_newton.dtype, device=gauss_newton.device)
    lower = torch.linalg.cholesky(torch.where(known, hessian, eye))
    axes = torch.linalg.inv(lower)  # a row for each direction
    variance = lower.transpose(-1, -2) @ torch.where(known, gauss_newton, eye) @ lower
    length = _CURVATURE_SIGMAS * variance.diagonal(dim1=-2, dim2=-1).mean(-1).sqrt()
    steps = length[:, None, None] * axes
    slopes = _gradients(cost, local.start, steps) - _gradients(cost, local.start, -steps)
    # Second derivatives in the axes in which the Gauss-Newton Hessian is the identity.
    curvature = (slopes / (2 * length[:, None, None])) @ axes.transpose(-1, -2)
    symmetric = 0.5 * (curvature + curvature.transpose(-1, -2)).nan_to_num()
    values, vectors = torch.linalg.eigh(symmetric)
    values = values.clamp(_MIN_CURVATURE_SHARE, 1)
    root = lower @ vectors * values.sqrt()[:, None]
    measured = _sandwich(root @ root.transpose(-1, -2), scatter, patches)
    scatter_level = (axes @ scatter @ axes.transpose(-1, -2)).diagonal(dim1=-2, dim2=-1).mean(-1)
    determined = known[:, 0, 0]
    return PoseUncertainty(
        torch.where(known, measured, gauss_newton),
        torch.where(determined, values.log().mean(-1).exp(), 0),
        depth.nanmedian(-1).values.nan_to_num(),
        patches,
        _view_cosine(problem, aligned, linearisation.seen),
        torch.where(determined, _informative_cost_ratio(cost, local.start, linearisation, axes), 1),
        torch.where(determined, scatter_level, 0),
        torch.where(determined, _effective_patches(grids, axes), 0),
    )


def _informative_cost_ratio(
    cost: LevelCost, pose: Pose, linearisation: Linearisation, axes: Tensor
) -> Tensor:
    """Return ``PoseUncertainty.informative_cost_ratio`` (B,), weighted by parts of the Hessian.

    Args:
        cost: cost of the finest level.
        pose: the poses (B).
        linearisation: the cost around the poses.
        axes: (B, 6, 6) rows along which the Hessian is the identity.
    """
    weight = linearisation.cost
    if cost.reference_confidence is not None:
        weight = weight * cost.reference_confidence
    weighted = replace(cost, reference_confidence=weight.to(cost.reference))
    shares = axes @ linearise(weighted, pose).hessian.double() @ axes.transpose(-1, -2)
    mean = linearisation.mean_cost().double()
    return torch.where(mean > 0, shares.diagonal(dim1=-2, dim2=-1).mean(-1) / mean, 1)


def _view_cosine(problem: Problem, aligned: Pose, seen: Tensor) -> Tensor:
    """Return ``PoseUncertainty.view_cosine`` (B,) over the points in view, (B, N)."""
    if problem.seen_from is None:
        return torch.ones(len(seen), dtype=torch.float64, device=seen.device)
    points = problem.points.double()
    from_query = points - aligned.centre()[:, None].to(points)
    from_references = points - problem.seen_from.to(points)
    cosine = torch.cosine_similarity(from_query, from_references, dim=-1)
    return torch.where(seen, cosine, torch.nan).nanmean(-1).nan_to_num(1.0)


def _gradients(cost: LevelCost, pose: Pose, steps: Tensor) -> Tensor:
    """Return the gradients (B, K, 6) of half the summed cost after steps (B, K, 6) from poses."""
    owner = torch.arange(len(steps), device=steps.device).repeat_interleave(steps.shape[1])
    shifted = apply_step(select(pose, owner), steps.flatten(0, 1))
    return linearise(cost.select(owner), shifted).gradient.double().view_as(steps)


_Grid = tuple[Tensor, Tensor]
"""Gradients (M, P, 6) of the patches of a grid, and the number (M,) of those with points."""


def _grids(linearisation: Linearisation, side: float) -> list[_Grid]:
    """Return the patches of four grids half a side apart, because their borders are arbitrary."""
    return [_sum_by_patch(linearisation, side, (x, y)) for x in (0.0, 0.5) for y in (0.0, 0.5)]


def _scatter(grids: list[_Grid]) -> tuple[Tensor, Tensor]:
    """Return the scatter (M, 6, 6) of the patches' gradients p, the sum of p p^T, and the number
    (M,) of patches with points.

    Both are means over the grids, so that the dependence of two points falls with their distance,
    as in Bartlett's window (Conley, Journal of Econometrics 1999).
    """
    scatters = torch.stack([_estimate_scatter(gradients, count) for gradients, count in grids])
    return scatters.mean(0), torch.stack([count for _, count in grids]).double().mean(0)


def _effective_patches(grids: list[_Grid], axes: Tensor) -> Tensor:
    """Return ``PoseUncertainty.effective_patches`` (M,): the grids' mean effective sample size.

    Source: Kish, "Survey Sampling", 1965.

    Args:
        grids: the patches.
        axes: (M, 6, 6) rows along which the Hessian is the identity.
    """
    each = [(gradients @ axes.transpose(-1, -2)).square().sum(-1) for gradients, _ in grids]
    return torch.stack([a.sum(-1).square() / a.square().sum(-1) for a in each]).mean(0)


def _estimate_scatter(gradients: Tensor, count: Tensor) -> Tensor:
    """Return the scatter (M, 6, 6) of gradients (M, P, 6), corrected for the fitted pose.

    ``count`` (M,) is the number of patches with points.
    """
    correction = count / (count - _PATCHES_PER_POSE).clamp_min(1)
    return gradients.transpose(-1, -2) @ gradients * correction[:, None, None]


def _sum_by_patch(linearisation: Linearisation, side: float, first: tuple[float, float]) -> _Grid:
    """Sum gradients over square patches, (M, P, 6), and count the patches with points, (M,).

    Args:
        linearisation: the cost around M poses.
        side: side of a patch, cells.
        first: position of the image's corner in the first patch, x and y, as shares of ``side``.
    """
    gradients = linearisation.point_gradient.detach().double()
    shift = torch.tensor(first, dtype=linearisation.cells.dtype, device=linearisation.cells.device)
    cells = torch.where(linearisation.seen[..., None], linearisation.cells, 0)
    patch = (cells / side + shift).floor().long()
    columns = int(patch[..., 0].max()) + 1 if patch.numel() else 1
    rows = int(patch[..., 1].max()) + 1 if patch.numel() else 1
    index = patch[..., 1] * columns + patch[..., 0]
    sums = gradients.new_zeros(len(gradients), columns * rows, gradients.shape[-1])
    sums = sums.scatter_add(1, index[..., None].expand_as(gradients), gradients)
    points = torch.zeros_like(sums[..., 0]).scatter_add(1, index, linearisation.seen.to(sums))
    return sums, (points > 0).sum(-1)
