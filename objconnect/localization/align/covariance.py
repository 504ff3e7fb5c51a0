"""Covariance of an aligned pose from its residuals and the curvature of the cost."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import torch
from torch import Tensor

from objconnect.localization.align.damping import apply_step
from objconnect.localization.align.linearise import linearise
from objconnect.localization.align.local_frame import Local
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import LevelCost, Linearisation
from objconnect.localization.align.trees import rows
from objconnect.scene.geometry.pose import Pose

# Degrees of freedom of a pose in patches, each of which contributes two.
_POSE_IN_PATCHES = 3
# Rotation variance (rad^2) from which the rotation counts as unknown.
_ANY_TURN = math.pi**2
# Side of the square patches of a level (cells) whose points count as dependent.
_PATCH_CELLS: Final = 24.0
# Share by which the scatter of the patches' gradients is shrunk to that of independent residuals.
_SHRINKAGE: Final = 0.6
# Distance from a pose, in standard deviations, at which the curvature of its cost is measured:
# nearer, noise of the features dominates; farther, the cost is not quadratic.
_CURVATURE_SIGMAS: Final = 3.6
# Lower bound of the measured curvature in any direction, as a share of Gauss-Newton's.
_LEAST_SHARE: Final = 0.05


def covariance(
    around: Linearisation, patch_cells: float = _PATCH_CELLS, shrinkage: float = _SHRINKAGE
) -> Tensor:
    """Return the covariance (M, 6, 6) of poses at the minimum of their cost, in double precision.

    It is Huber's sandwich H^-1 S H^-1, where S is the sum of p p^T and p the gradient ("pull") of
    each patch of the image. Channels of a feature and points of one patch may depend on one another
    (Liang and Zeger, Biometrika 1986, on clusters): neighbours show the same, and a point occurs
    once for each reference image. S is scaled up for the degrees of freedom of the pose itself. The
    diagonal is infinite where the points do not determine a pose.

    Args:
        around: the cost at the M poses.
        patch_cells: side of the patches, cells.
        shrinkage: share by which S is shrunk to that of independent residuals, 0 to 1.
    """
    scatter, count = _scatter(_grids(around, patch_cells))
    return _sandwich(around.hessian.detach().double(), scatter, count, shrinkage)


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
        shrinkage: share of that multiple of H.
    """
    enough = count > _POSE_IN_PATCHES
    factor, info = torch.linalg.cholesky_ex(H)
    determined = enough & (info == 0)
    eye = torch.eye(6, dtype=H.dtype, device=H.device)
    factor = torch.where(determined[:, None, None], factor, eye)
    half = torch.linalg.solve_triangular(factor, scatter, upper=False)
    white = torch.linalg.solve_triangular(factor, half.transpose(-1, -2), upper=False)
    level = white.diagonal(dim1=-2, dim2=-1).mean(-1)[:, None, None]
    white = (1 - shrinkage) * white + shrinkage * level * eye
    upper = factor.transpose(-1, -2)
    half = torch.linalg.solve_triangular(upper, white, upper=True)
    result = torch.linalg.solve_triangular(upper, half.transpose(-1, -2), upper=True)
    turn = result.diagonal(dim1=-2, dim2=-1)[:, :3].amax(-1)
    good = determined & result.isfinite().flatten(1).all(-1) & (turn < _ANY_TURN)
    unknown = torch.full_like(H[0, 0], torch.inf).diag_embed().expand_as(H)
    return torch.where(good[:, None, None], 0.5 * (result + result.transpose(-1, -2)), unknown)


@dataclass(frozen=True)
class Spread:
    """Uncalibrated covariances of aligned poses, and the figures that calibrate them.

    Attributes:
        covariance: (B, 6, 6) of the left tangent, rotation (rad) then translation (m); infinite on
            the diagonal where the points do not determine a pose.
        curvature: (B,) geometric mean of the curvature of the cost over six directions, as a share
            of Gauss-Newton's, at most 1; 0 where the points do not determine a pose.
        depth: (B,) median depth of the points in view, metres; zero without any.
        patches: (B,) number of patches of the image with points in view.
        view_cosine: (B,) mean cosine of the angle between the directions in which the query and the
            reference images see the points in view; 1 if the latter are unknown.
        informative_cost: (B,) mean cost of the points, weighted by their information on the pose,
            as a share of their mean cost; 1 where they do not determine a pose.
        level: (B,) mean over six directions of the scatter of the patches' gradients, as a share of
            the Gauss-Newton Hessian; 0 where the points do not determine a pose.
        equal_patches: (B,) effective number of patches for ``level``.
    """

    covariance: Tensor
    curvature: Tensor
    depth: Tensor
    patches: Tensor
    view_cosine: Tensor
    informative_cost: Tensor
    level: Tensor
    equal_patches: Tensor


def measure_spread(problem: Problem, aligned: Pose) -> Spread:
    """Compute the covariances of poses (B) aligned on the finest level of a problem.

    If a query differs from the map, as in snow, the Gauss-Newton Hessian is too large: it includes
    the slopes of everything in the query, also of what the map does not have. Therefore the second
    derivatives of the cost are measured by differences of gradients, along the axes in which that
    Hessian is the identity, and replace it where they are smaller.

    Args:
        problem: the alignment problem.
        aligned: ``cam_from_world`` at the minimum.
    """
    local = Local.of(problem.starting_at(aligned))
    cost = local.cost(problem.levels[-1], problem.options)
    around = linearise(cost, local.start)
    depth = local.start.to(dtype=local.points.dtype).transform(local.points)[..., 2].double()
    depth = torch.where(around.seen, depth, torch.nan)
    grids = _grids(around, _PATCH_CELLS)
    scatter, patches = _scatter(grids)
    hessian = around.hessian.detach().double()
    first = _sandwich(hessian, scatter, patches)
    known = (local.finite & first.isfinite().flatten(1).all(-1))[:, None, None]
    eye = torch.eye(6, dtype=first.dtype, device=first.device)
    lower = torch.linalg.cholesky(torch.where(known, hessian, eye))
    axes = torch.linalg.inv(lower)  # a row for each direction
    variance = lower.transpose(-1, -2) @ torch.where(known, first, eye) @ lower
    length = _CURVATURE_SIGMAS * variance.diagonal(dim1=-2, dim2=-1).mean(-1).sqrt()
    steps = length[:, None, None] * axes
    slopes = _gradients(cost, local.start, steps) - _gradients(cost, local.start, -steps)
    share = (slopes / (2 * length[:, None, None])) @ axes.transpose(-1, -2)
    values, vectors = torch.linalg.eigh(0.5 * (share + share.transpose(-1, -2)).nan_to_num())
    values = values.clamp(_LEAST_SHARE, 1)
    root = lower @ vectors * values.sqrt()[:, None]
    measured = _sandwich(root @ root.transpose(-1, -2), scatter, patches)
    level = (axes @ scatter @ axes.transpose(-1, -2)).diagonal(dim1=-2, dim2=-1).mean(-1)
    determined = known[:, 0, 0]
    return Spread(
        torch.where(known, measured, first),
        torch.where(determined, values.log().mean(-1).exp(), 0),
        depth.nanmedian(-1).values.nan_to_num(),
        patches,
        _view_cosine(problem, aligned, around.seen),
        torch.where(determined, _informative_cost(cost, local.start, around, axes), 1),
        torch.where(determined, level, 0),
        torch.where(determined, _equal_patches(grids, axes), 0),
    )


def _informative_cost(cost: LevelCost, pose: Pose, around: Linearisation, axes: Tensor) -> Tensor:
    """Return ``Spread.informative_cost`` (B,): points are weighted by their part of the Hessian.

    Args:
        cost: cost of the finest level.
        pose: the poses (B).
        around: the cost there.
        axes: (B, 6, 6) rows along which the Hessian is the identity.
    """
    trust = around.cost if cost.target_trust is None else around.cost * cost.target_trust
    heavy = linearise(replace(cost, target_trust=trust.to(cost.target)), pose).hessian.double()
    shares = axes @ heavy @ axes.transpose(-1, -2)
    mean = around.mean_cost().double()
    return torch.where(mean > 0, shares.diagonal(dim1=-2, dim2=-1).mean(-1) / mean, 1)


def _view_cosine(problem: Problem, aligned: Pose, seen: Tensor) -> Tensor:
    """Return ``Spread.view_cosine`` (B,) over the points in view, (B, N)."""
    if problem.seen_from is None:
        return torch.ones(len(seen), dtype=torch.float64, device=seen.device)
    points = problem.points.double()
    here = points - aligned.centre()[:, None].to(points)
    cosine = torch.cosine_similarity(here, points - problem.seen_from.to(points), dim=-1)
    return torch.where(seen, cosine, torch.nan).nanmean(-1).nan_to_num(1.0)


def _gradients(cost: LevelCost, pose: Pose, steps: Tensor) -> Tensor:
    """Return the gradients (B, K, 6) of half the summed cost after steps (B, K, 6) from poses."""
    owner = torch.arange(len(steps), device=steps.device).repeat_interleave(steps.shape[1])
    shifted = apply_step(rows(pose, owner), steps.flatten(0, 1))
    return linearise(cost.rows(owner), shifted).gradient.double().view_as(steps)


_Grid = tuple[Tensor, Tensor]
"""Gradients (M, P, 6) of the patches of a grid, and the number (M,) of those with points."""


def _grids(around: Linearisation, side: float) -> list[_Grid]:
    """Return the patches of four grids half a side apart, because their borders are arbitrary."""
    return [_by_patch(around, side, (x, y)) for x in (0.0, 0.5) for y in (0.0, 0.5)]


def _scatter(grids: list[_Grid]) -> tuple[Tensor, Tensor]:
    """Sum p p^T over square patches, (M, 6, 6), and count the patches with points, (M,).

    Both are means over the grids, so that the dependence of two points falls with their distance,
    as in Bartlett's window (Conley, Journal of Econometrics 1999).
    """
    scatter = torch.stack([_unbiased_scatter(pull, count) for pull, count in grids]).mean(0)
    return scatter, torch.stack([count for _, count in grids]).double().mean(0)


def _equal_patches(grids: list[_Grid], axes: Tensor) -> Tensor:
    """Return ``Spread.equal_patches`` (M,): Kish's effective sample size, a mean over the grids.

    See Kish, "Survey Sampling", 1965.

    Args:
        grids: the patches.
        axes: (M, 6, 6) rows along which the Hessian is the identity.
    """
    each = [(pull @ axes.transpose(-1, -2)).square().sum(-1) for pull, _ in grids]
    return torch.stack([a.sum(-1).square() / a.square().sum(-1) for a in each]).mean(0)


def _unbiased_scatter(pull: Tensor, count: Tensor) -> Tensor:
    """Return the scatter (M, 6, 6) of gradients (M, P, 6), corrected for the fitted pose."""
    used = count / (count - _POSE_IN_PATCHES).clamp_min(1)
    return pull.transpose(-1, -2) @ pull * used[:, None, None]


def _by_patch(around: Linearisation, side: float, first: tuple[float, float]) -> _Grid:
    """Sum gradients over square patches, (M, P, 6), and count the patches with points, (M,).

    Args:
        around: the cost at M poses.
        side: side of a patch, cells.
        first: position of the image's corner in the first patch, as shares of its side, x and y.
    """
    pull = around.pull.detach().double()
    shift = torch.tensor(first, dtype=around.cells.dtype, device=around.cells.device)
    cells = torch.where(around.seen[..., None], around.cells, 0)
    patch = (cells / side + shift).floor().long()
    wide = int(patch[..., 0].max()) + 1 if patch.numel() else 1
    high = int(patch[..., 1].max()) + 1 if patch.numel() else 1
    index = patch[..., 1] * wide + patch[..., 0]
    sums = pull.new_zeros(len(pull), wide * high, pull.shape[-1])
    sums = sums.scatter_add(1, index[..., None].expand_as(pull), pull)
    points = torch.zeros_like(sums[..., 0]).scatter_add(1, index, around.seen.to(sums))
    return sums, (points > 0).sum(-1)
