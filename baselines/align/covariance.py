"""How far a pose may be off, from the residuals it was found by."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from baselines.align.residuals import Linearisation

# Degrees of freedom of a pose, in points: each point says two numbers.
_POSE_IN_POINTS = 3
# A variance (rad^2) that says nothing of a rotation.
_ANY_TURN = math.pi**2


def covariance(around: Linearisation) -> Tensor:
    """Covariance (M, 6, 6) of poses at the minimum of their cost, in double precision.

    Huber's sandwich H^-1 (sum of p p^T) H^-1, with p the pull of each point on the pose. It takes
    no view on how the channels of a feature depend on one another, only that points are
    independent, and grows by the points that the pose itself used up. Infinite on the diagonal
    where the points do not determine a pose.
    """
    H, pull = around.hessian.detach().double(), around.pull.detach().double()
    count = around.seen.sum(-1)
    enough = count > _POSE_IN_POINTS
    factor, info = torch.linalg.cholesky_ex(H)
    determined = enough & (info == 0)
    eye = torch.eye(6, dtype=H.dtype, device=H.device)
    factor = torch.where(determined[:, None, None], factor, eye)
    spread = pull.transpose(-1, -2) @ pull
    inner = torch.cholesky_solve(spread, factor)
    sandwich = torch.cholesky_solve(inner.transpose(-1, -2), factor)
    used = count / (count - _POSE_IN_POINTS).clamp_min(1)
    result = sandwich * used[:, None, None]
    turn = result.diagonal(dim1=-2, dim2=-1)[:, :3].amax(-1)
    good = determined & result.isfinite().flatten(1).all(-1) & (turn < _ANY_TURN)
    unknown = torch.full_like(H[0, 0], torch.inf).diag_embed().expand_as(H)
    return torch.where(good[:, None, None], 0.5 * (result + result.transpose(-1, -2)), unknown)
