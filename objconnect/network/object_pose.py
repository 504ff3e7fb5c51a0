"""The pose of a camera from objects matched with landmarks, by least squares in six dimensions.

A landmark is an object of the map, with its position. The first pose assumes level ground and one
of a few attitudes, so its tilt is off by some degrees. The matched objects determine the tilt too.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.scene.geometry.pose import Pose, so3_exp

_Vector = NDArray[np.float64]
# Standard deviations: of an object's ray (rad), and of the tilt and roll of the first pose (rad).
_RAY_SIGMA: Final = 0.06
_TILT_SIGMA: Final = math.radians(4)
# Steps of Gauss-Newton.
_STEPS: Final = 4
# Least number of matches for a change of the pose.
_MIN_MATCHES: Final = 6


def refine_pose(pose: Pose, rays: _Vector, xyz: _Vector, weights: _Vector) -> Pose:
    """Return the pose that fits the matches best and stays near the tilt of the first pose.

    Args:
        pose: first pose, ``cam_from_world``.
        rays: (N, 2) objects in the image plane at depth one.
        xyz: (N, 3) landmarks, world metres.
        weights: (N,) weights of the matches, at least 0.

    Returns:
        The pose; the first one if it has few matches or no better fit exists.
    """
    used = weights > 0
    rays, xyz, weights = rays[used], xyz[used], weights[used] / max(weights.max(), 1e-12)
    if len(rays) < _MIN_MATCHES:
        return pose
    first, best, least = pose, pose, math.inf
    for step in range(_STEPS + 1):
        system = _linearise(pose, first, rays, xyz, weights)
        if system is None:
            break
        cost, gradient, hessian = system
        if cost < least:
            best, least = pose, cost
        if step < _STEPS:
            change = torch.from_numpy(np.linalg.solve(hessian, -gradient))
            rotation = so3_exp(change[:3]) @ pose.rotation
            pose = Pose(rotation, -rotation @ (pose.centre() + change[3:]))
    return best


def _linearise(
    pose: Pose, first: Pose, rays: _Vector, xyz: _Vector, weights: _Vector
) -> tuple[float, _Vector, _Vector] | None:
    """Return cost, gradient (6,) and Gauss-Newton matrix (6, 6) of rotation and centre.

    It is None if a landmark is behind the camera.
    """
    rotation = pose.rotation.numpy()
    in_camera = (xyz - pose.centre().numpy()) @ rotation.T
    depth = in_camera[:, 2]
    if (depth < 1e-3).any():
        return None
    x, y = (in_camera[:, :2] / depth[:, None]).T
    residual = np.stack([x - rays[:, 0], y - rays[:, 1]], -1)
    zero = np.zeros_like(x)
    by_point = np.stack([1 / depth, zero, -x / depth, zero, 1 / depth, -y / depth], -1)
    by_point = by_point.reshape(-1, 2, 3)
    by_turn = np.stack([-x * y, 1 + x**2, -y, -(1 + y**2), x * y, x], -1).reshape(-1, 2, 3)
    jacobian = np.concatenate([by_turn, -by_point @ rotation], -1) / _RAY_SIGMA
    residual = residual / _RAY_SIGMA
    hessian = np.einsum("n,nki,nkj->ij", weights, jacobian, jacobian)
    gradient = np.einsum("n,nki,nk->i", weights, jacobian, residual)
    # The change of the vertical in the camera's axes: the prior of tilt and roll.
    up, up_first = rotation[:, 2], first.rotation.numpy()[:, 2]
    turned = np.cross(up_first, up) / _TILT_SIGMA
    across = (np.eye(3) - np.outer(up, up)) / _TILT_SIGMA
    hessian[:3, :3] += across.T @ across
    gradient[:3] += across.T @ turned
    # Keeps the matrix invertible where matches lie on a line.
    hessian += np.diag([1e-3] * 3 + [1e-6] * 3)
    cost = float(weights @ np.square(residual).sum(1) + turned @ turned)
    return cost, gradient, hessian
