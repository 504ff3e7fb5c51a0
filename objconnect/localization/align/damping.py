"""Damped steps of the alignment, with a damping for each of the six directions of the pose."""

from __future__ import annotations

import torch
from torch import Tensor

from objconnect.scene.geometry.pose import Pose, so3_exp

# Numerical guard: least value that is added to the diagonal of the Hessian, in its units.
MIN_ADDED = 1e-6
# A rejected step multiplies the damping by this, and an accepted step divides the damping by it.
DAMPING_CHANGE = 10.0
# Bounds of the product of these changes, which multiplies the learned damping of a level.
MIN_FACTOR, MAX_FACTOR = 1e-3, 1e8


def solve_step(gradient: Tensor, hessian: Tensor, damping: Tensor) -> Tensor:
    """Return the steps -(H + damping * diag H)^-1 g (Marquardt), in double precision.

    If the damped Hessian is not positive definite, only its diagonal is used.

    Args:
        gradient: (M, 6) g.
        hessian: (M, 6, 6) H.
        damping: (6,) or (M, 6) shares of the diagonal of H that are added to it.
    """
    H, g = hessian.double(), gradient.double()
    diagonal = H.diagonal(dim1=-2, dim2=-1)
    added = (diagonal * damping).clamp_min(MIN_ADDED)
    H = H + added.diag_embed()
    diagonal_only = (diagonal.abs() + added).diag_embed()
    is_indefinite = torch.linalg.cholesky_ex(H.detach()).info != 0
    usable = torch.where(is_indefinite[..., None, None], diagonal_only, H)
    cholesky = torch.linalg.cholesky_ex(usable).L
    return -torch.cholesky_solve(g[..., None], cholesky)[..., 0]


def apply_step(cam_from_world: Pose, step: Tensor) -> Pose:
    """Apply steps to poses: rotate in the camera frame, then translate.

    Rotation and translation are updated separately. This is the exponential of SE(3) to first order
    and the convention of PixLoc's weights.

    Args:
        cam_from_world: (M) poses.
        step: (M, 6) rotation vector (rad), then translation (m), in the camera frame.
    """
    rotation, translation = so3_exp(step[..., :3]), step[..., 3:]
    return Pose(
        rotation @ cam_from_world.rotation,
        (rotation @ cam_from_world.translation[..., None])[..., 0] + translation,
    )
