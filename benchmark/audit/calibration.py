"""Focal length and principal point against the matches, with the poses as they stand.

One factor on all focal lengths and one shift of all principal points are fitted to the Sampson
errors. Their standard errors come from the scatter between pairs (a sandwich estimate), because the
matches of one pair share its errors. A flight straight on, level and in one direction does not tell
either of them; its standard errors then say so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.sampson import Matches
from benchmark.audit.agreement import Rays, errors, rays_of
from benchmark.audit.matches import Pair
from scene.geometry.camera import MODELS, Camera
from scene.geometry.pose import Pose

Array = NDArray[np.float64]

# Iterations of Gauss-Newton, and the steps of its differences (log focal length, px, px).
_ITERATIONS = 8
_STEPS = (1e-4, 1e-2, 1e-2)
# Scale of the Cauchy weights in standard deviations of the errors.
_CAUCHY = 2.385
_SIGMA_OF_MEDIAN = 1.4826
_LEAST_SIGMA = 0.02
# Matches whose error is larger than this many thresholds at the beginning take no part.
_FAR = 12.0
# A ridge that keeps the step finite where the matches do not tell a parameter.
_RIDGE = 1e-9


@dataclass(frozen=True)
class Correction:
    """What the matches say of the cameras.

    Attributes:
        focal: factor on the focal lengths.
        focal_sigma: its standard error.
        shift: shift (2,) of the principal points, pixels.
        shift_sigma: its standard errors (2,).
    """

    focal: float
    focal_sigma: float
    shift: Array
    shift_sigma: Array


def corrected(camera: Camera, focal: float, shift: Sequence[float]) -> Camera:
    """Return a camera with its focal length multiplied and its principal point moved (px)."""
    moves = {"cx": shift[0], "cy": shift[1]}
    params = tuple(
        value * focal if name in ("f", "fx", "fy") else value + moves.get(name, 0.0)
        for name, value in zip(MODELS[camera.model], camera.params, strict=True)
    )
    return replace(camera, params=params)


def correction(
    pairs: Sequence[Pair], cameras: Sequence[Camera | None], poses: Array
) -> Correction | None:
    """Fit the correction of all cameras; None where no pair tells anything.

    Args:
        pairs: matches.
        cameras: stated cameras of all photographs.
        poses: cam_from_world (N, 4, 4), in the convention that agrees with the photographs.
    """
    near = []
    for rays in rays_of(pairs, cameras):
        kept = errors(rays, poses) < _FAR * rays.threshold
        if kept.sum() > 0 and len(kept) == len(rays.pair):
            near.append(
                Pair(
                    rays.pair.first,
                    rays.pair.second,
                    rays.pair.xy_first[kept],
                    rays.pair.xy_second[kept],
                )
            )
    if len(near) < 4:
        return None
    values = np.zeros(3)
    for _ in range(_ITERATIONS):
        residuals, jacobians = _linearised(near, cameras, poses, values)
        hessian, gradients = _normal(residuals, jacobians)
        step = -np.linalg.solve(hessian, gradients.sum(0))
        values += np.clip(step, [-0.1, -20, -20], [0.1, 20, 20])
    residuals, jacobians = _linearised(near, cameras, poses, values)
    hessian, gradients = _normal(residuals, jacobians)
    inverse = np.linalg.inv(hessian)
    sigma = np.sqrt(np.diag(inverse @ (gradients.T @ gradients) @ inverse))
    focal = float(np.exp(values[0]))
    return Correction(focal, float(sigma[0] * focal), values[1:], sigma[1:])


def _residuals(
    pairs: Sequence[Pair], cameras: Sequence[Camera | None], poses: Array, values: Array
) -> list[Array]:
    read = [
        None if camera is None else corrected(camera, float(np.exp(values[0])), values[1:].tolist())
        for camera in cameras
    ]
    found = []
    for pair in pairs:
        a, b = read[pair.first], read[pair.second]
        assert a is not None and b is not None
        first, _ = a.unproject(torch.from_numpy(pair.xy_first))
        second, _ = b.unproject(torch.from_numpy(pair.xy_second))
        matches = Matches(Pose.from_matrix(poses[pair.first]), second, first)
        pose = Pose.from_matrix(poses[pair.second])
        error, _ = matches.residuals(pose, float(np.mean(b.focal)))
        found.append(np.asarray(error.numpy(), np.float64))
    return found


def _linearised(
    pairs: Sequence[Pair], cameras: Sequence[Camera | None], poses: Array, values: Array
) -> tuple[list[Array], list[Array]]:
    """Return the errors (K,) of each pair and their derivatives (K, 3), by differences."""
    columns = []
    for k, step in enumerate(_STEPS):
        move = np.eye(3)[k] * step
        ahead = _residuals(pairs, cameras, poses, values + move)
        behind = _residuals(pairs, cameras, poses, values - move)
        columns.append([(p - m) / (2 * step) for p, m in zip(ahead, behind, strict=True)])
    jacobians = [np.stack(parts, -1) for parts in zip(*columns, strict=True)]
    return _residuals(pairs, cameras, poses, values), jacobians


def _normal(residuals: Sequence[Array], jacobians: Sequence[Array]) -> tuple[Array, Array]:
    """Return the matrix (3, 3) of the normal equations and the gradient (P, 3) of each pair."""
    every = np.abs(np.concatenate(residuals))
    sigma = max(_SIGMA_OF_MEDIAN * float(np.median(every)), _LEAST_SIGMA)
    weights = [1 / (1 + (r / (_CAUCHY * sigma)) ** 2) for r in residuals]
    hessian = _RIDGE * np.eye(3)
    gradients = np.zeros((len(residuals), 3))
    for row, (r, j, w) in enumerate(zip(residuals, jacobians, weights, strict=True)):
        hessian = hessian + (w[:, None] * j).T @ j
        gradients[row] = (w[:, None] * j).T @ r
    return hessian, gradients
