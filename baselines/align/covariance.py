"""Covariance of an aligned pose, from the residuals it was found by."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from baselines.align.residuals import Linearisation

# Degrees of freedom of a pose, in patches: each patch contributes two numbers.
_POSE_IN_PATCHES = 3
# A rotation variance (rad^2) as large as this means that nothing is known of the rotation.
_ANY_TURN = math.pi**2


def covariance(around: Linearisation, patch_cells: float) -> Tensor:
    """Covariance (M, 6, 6) of poses at the minimum of their cost, in double precision.

    Huber's sandwich H^-1 (sum of p p^T) H^-1, with p the pull of each patch of the picture on the
    pose. It assumes nothing about how the channels of a feature depend on one another, nor the
    points of one patch (Liang and Zeger, Biometrika 1986, on clusters): neighbours see the same,
    and a point may occur several times, as several photographs show it. It is scaled up for the
    degrees of freedom that the pose itself uses. Infinite on the diagonal where the points do not
    determine a pose.

    Args:
        around: the cost at the M poses.
        patch_cells: side of the square patches, cells of the level.
    """
    H, pull = around.hessian.detach().double(), around.pull.detach().double()
    pull, count = _by_patch(around, pull, patch_cells)
    enough = count > _POSE_IN_PATCHES
    factor, info = torch.linalg.cholesky_ex(H)
    determined = enough & (info == 0)
    eye = torch.eye(6, dtype=H.dtype, device=H.device)
    factor = torch.where(determined[:, None, None], factor, eye)
    scatter = pull.transpose(-1, -2) @ pull
    inner = torch.cholesky_solve(scatter, factor)
    sandwich = torch.cholesky_solve(inner.transpose(-1, -2), factor)
    used = count / (count - _POSE_IN_PATCHES).clamp_min(1)
    result = sandwich * used[:, None, None]
    turn = result.diagonal(dim1=-2, dim2=-1)[:, :3].amax(-1)
    good = determined & result.isfinite().flatten(1).all(-1) & (turn < _ANY_TURN)
    unknown = torch.full_like(H[0, 0], torch.inf).diag_embed().expand_as(H)
    return torch.where(good[:, None, None], 0.5 * (result + result.transpose(-1, -2)), unknown)


def _by_patch(around: Linearisation, pull: Tensor, side: float) -> tuple[Tensor, Tensor]:
    """Sum pulls over square patches, (M, P, 6), and count the patches with points, (M,)."""
    patch = torch.where(around.seen[..., None], around.cells, 0).div(side).floor().long()
    wide = int(patch[..., 0].max()) + 1 if patch.numel() else 1
    high = int(patch[..., 1].max()) + 1 if patch.numel() else 1
    index = patch[..., 1] * wide + patch[..., 0]
    sums = pull.new_zeros(len(pull), wide * high, pull.shape[-1])
    sums = sums.scatter_add(1, index[..., None].expand_as(pull), pull)
    points = torch.zeros_like(sums[..., 0]).scatter_add(1, index, around.seen.to(sums))
    return sums, (points > 0).sum(-1)
