"""Damped steps of the aligner, with learned or fixed damping of each direction of the pose."""

from __future__ import annotations

import torch
from torch import Tensor

from objconnect.scene.geometry.pose import Pose, so3_exp

# Numerical guard: the least value added to the diagonal of the Hessian, in its units.
FLOOR = 1e-6
# A rejected step multiplies the factor on the damping by this; an accepted one divides it.
CHANGE = 10.0
# Numerical bounds of that factor.
LEAST_FACTOR, MOST_FACTOR = 1e-3, 1e8


def solve_step(gradient: Tensor, hessian: Tensor, damping: Tensor) -> Tensor:
    """Compute the steps -(H + damping * diag H)^-1 g (Marquardt), in double precision.

    Where the damped Hessian is not positive definite, only its diagonal is used.

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
    """Apply steps (M, 6) to poses (M): turn about the camera, then shift.

    Rotation and translation are updated separately, which is the exponential of SE(3) to first
    order and what weights trained elsewhere expect.
    """
    turn, shift = so3_exp(step[..., :3]), step[..., 3:]
    return Pose(
        turn @ cam_from_world.rotation,
        (turn @ cam_from_world.translation[..., None])[..., 0] + shift,
    )
