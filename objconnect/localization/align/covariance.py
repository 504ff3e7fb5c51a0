"""Covariance of an aligned pose, from the residuals it was found by and the curvature there."""

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

# Degrees of freedom of a pose, in patches: each patch contributes two numbers.
_POSE_IN_PATCHES = 3
# A rotation variance (rad^2) as large as this means that nothing is known of the rotation.
_ANY_TURN = math.pi**2
# Side of the square patches of a level (cells) whose points count as dependent.
_PATCH_CELLS: Final = 24.0
# How far the scatter of the patches' pulls is drawn to that of independent residuals.
_SHRINKAGE: Final = 0.6
# Standard deviations from a pose at which the curvature of its cost is measured: nearer, noise of
# the features decides; farther, the cost is no parabola.
_CURVATURE_SIGMAS: Final = 3.6
# Least curvature assumed in any direction, as a share of Gauss and Newton's: no direction in which
# points pull is quite unknown.
_LEAST_SHARE: Final = 0.05


def covariance(
    around: Linearisation, patch_cells: float = _PATCH_CELLS, shrinkage: float = _SHRINKAGE
) -> Tensor:
    """Covariance (M, 6, 6) of poses at the minimum of their cost, in double precision.

    Huber's sandwich H^-1 S H^-1, with S the sum of p p^T and p the pull of each patch of the
    picture on the pose. It assumes nothing about how the channels of a feature depend on one
    another, nor the points of one patch (Liang and Zeger, Biometrika 1986, on clusters): neighbours
    see the same, and a point may occur several times, as several photographs show it. S is scaled
    up for the degrees of freedom that the pose itself uses. Infinite on the diagonal where the
    points do not determine a pose.

    Args:
        around: the cost at the M poses.
        patch_cells: side of the patches, cells.
        shrinkage: how far S is drawn to what independent residuals would give, 0 to 1.
    """
    scatter, count = _scatter(_grids(around, patch_cells))
    return _sandwich(around.hessian.detach().double(), scatter, count, shrinkage)


def _sandwich(H: Tensor, scatter: Tensor, count: Tensor, shrinkage: float = _SHRINKAGE) -> Tensor:
    """Return covariances (M, 6, 6) as ``covariance`` does.

    Few patches tell six directions apart badly: of their scatter the largest axes are too large and
    the smallest too small. It is drawn to the multiple of H with the same trace where H is the
    identity (Ledoit and Wolf, Journal of Multivariate Analysis 2004).

    Args:
        H: (M, 6, 6) second derivatives of half the summed cost. Those of Gauss and Newton are right
            where residuals are small.
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
    """How far aligned poses may be off, as far as the query tells.

    Attributes:
        covariance: (B, 6, 6) of the left tangent, rotation (rad) then translation (m); infinite on
            the diagonal where the points do not determine a pose.
        curvature: (B,) geometric mean of the curvature of the cost over six directions, as a share
            of Gauss and Newton's, at most 1; 0 where the points do not determine a pose.
        depth: (B,) median depth of the points in view, metres; zero without any.
        patches: (B,) number of patches of the picture with points in view.
        view_cosine: (B,) mean cosine of the angle between the directions in which the pose and the
            photographs of the features see the points in view; 1 if the latter are not known.
        informative_cost: (B,) mean cost of the points by how much each tells of the pose, as a
            share of their mean cost; 1 where they do not determine a pose.
        level: (B,) mean over six directions of the scatter of the patches' pulls, as a share of the
            Hessian of Gauss and Newton; 0 where the points do not determine a pose.
        equal_patches: (B,) number of equal patches whose level would be known as well.
    """

    covariance: Tensor
    curvature: Tensor
    depth: Tensor
    patches: Tensor
    view_cosine: Tensor
    informative_cost: Tensor
    level: Tensor
    equal_patches: Tensor


def spread(problem: Problem, aligned: Pose) -> Spread:
    """Compute the covariances of poses (B) aligned on the finest level of a problem.

    Where a query hardly looks like the map, as in snow, the Hessian of Gauss and Newton is too
    large: it counts the slopes of all that the query shows, also of what the map does not know and
    the cost does not follow. So the second derivatives of the cost are measured, by differences of
    gradients along the axes in which that Hessian is the identity, and count where they are less.

    Args:
        problem: what was aligned.
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
    """Return mean costs (B,) as in ``Spread``: a point counts by its part of the Hessian.

    Args:
        cost: of the poses.
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
    """Return mean cosines (B,) as in ``Spread``, over the points in view, (B, N)."""
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
"""Pulls (M, P, 6) of the patches of a grid, and the number (M,) of those with points."""


def _grids(around: Linearisation, side: float) -> list[_Grid]:
    """Return the patches of four grids half a side apart, as where borders lie is arbitrary."""
    return [_by_patch(around, side, (x, y)) for x in (0.0, 0.5) for y in (0.0, 0.5)]


def _scatter(grids: list[_Grid]) -> tuple[Tensor, Tensor]:
    """Sum p p^T over square patches, (M, 6, 6), and count the patches with points, (M,).

    Both are means over the grids. Points thus count as the less dependent the farther apart they
    are, as in Bartlett's window (Conley, Journal of Econometrics 1999).
    """
    scatter = torch.stack([_unbiased_scatter(pull, count) for pull, count in grids]).mean(0)
    return scatter, torch.stack([count for _, count in grids]).double().mean(0)


def _equal_patches(grids: list[_Grid], axes: Tensor) -> Tensor:
    """Return numbers of equal patches (M,) as in ``Spread``, means over the grids.

    Where some patches pull more than others, their mean is known as well as that of fewer equal
    ones (Kish, "Survey Sampling", 1965).

    Args:
        grids: the patches.
        axes: (M, 6, 6) rows along which the Hessian is the identity.
    """
    each = [(pull @ axes.transpose(-1, -2)).square().sum(-1) for pull, _ in grids]
    return torch.stack([a.sum(-1).square() / a.square().sum(-1) for a in each]).mean(0)


def _unbiased_scatter(pull: Tensor, count: Tensor) -> Tensor:
    """Return the scatter (M, 6, 6) of the pulls (M, P, 6) that a pose was fitted to."""
    used = count / (count - _POSE_IN_PATCHES).clamp_min(1)
    return pull.transpose(-1, -2) @ pull * used[:, None, None]


def _by_patch(around: Linearisation, side: float, first: tuple[float, float]) -> _Grid:
    """Sum pulls over square patches, (M, P, 6), and count the patches with points, (M,).

    Args:
        around: the cost at M poses.
        side: of a patch, cells.
        first: where the picture begins in the first patch, as shares of its side, x and y.
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
