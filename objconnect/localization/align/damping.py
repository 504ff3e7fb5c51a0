"""Damped steps of the alignment, with a damping factor for each direction of the pose."""

from __future__ import annotations

import torch
from torch import Tensor

from objconnect.scene.geometry.pose import Pose, so3_exp

# Numerical guard: least value that is added to the diagonal of the Hessian, in its units.
FLOOR = 1e-6
# Factor on the damping after a rejected step; an accepted one divides by it.
CHANGE = 10.0
# Numerical bounds of that factor.
LEAST_FACTOR, MOST_FACTOR = 1e-3, 1e8


def solve_step(gradient: Tensor, hessian: Tensor, damping: Tensor) -> Tensor:
    """Return the steps -(H + damping * diag H)^-1 g (Marquardt), in double precision.

    If the damped Hessian is not positive definite, only its diagonal is used.

    Args:
        gradient: (M, 6).
        hessian: (M, 6, 6).
        damping: (6,) or (M, 6).
    """
    H, g = hessian.double(), gradient.double()
    diagonal = H.diagonal(dim1=-2, dim2=-1)
    added = (diagonal * damping).clamp_min(FLOOR)
    H = H + added.diag_embed()
    alone = (diagonal.abs() + added).diag_embed()
    broken = torch.linalg.cholesky_ex(H.detach()).info != 0
    factor = torch.linalg.cholesky_ex(torch.where(broken[..., None, None], alone, H)).L
    return -torch.cholesky_solve(g[..., None], factor)[..., 0]


def apply_step(cam_from_world: Pose, step: Tensor) -> Pose:
    """Apply steps (M, 6) to poses (M): rotate about the camera, then translate.

    Rotation and translation are updated separately. This is the exponential of SE(3) to first order
    and the convention of PixLoc's weights.
    """
    turn, shift = so3_exp(step[..., :3]), step[..., 3:]
    return Pose(
        turn @ cam_from_world.rotation,
        (turn @ cam_from_world.translation[..., None])[..., 0] + shift,
    )
