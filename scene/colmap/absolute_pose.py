"""A camera's pose from 2D-3D matches, and how exact it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap
import torch
from numpy.typing import NDArray

from scene.colmap.native import CAUCHY, LEAST_VARIANCE, native_camera, pose_from_native
from scene.geometry.camera import Camera
from scene.geometry.pose import Pose, transform_jacobian

# Matches that determine a pose: their residuals are zero, whatever the matches are.
_MINIMAL = 3


# A condition number beyond which nothing is left of double precision.
_SINGULAR = 1e15


# Squared deviation in standard deviations, of three degrees of freedom, beyond which a position and
# the matches are not of one camera: one in ten billion.
_CONTRADICTS = 50.0


# No GNSS is better than this (m), a sigma of zero would leave nothing to solve for; and one of so
# much says nothing, as an infinite one does.
_LEAST_SIGMA = 1e-3
_LARGEST_SIGMA = 1e6


@dataclass(frozen=True)
class PnpResult:
    """A pose from 2D-3D matches.

    Attributes:
        cam_from_world: refined on the inliers.
        inliers: (N,) bool.
        covariance: (6, 6) of the left tangent of ``cam_from_world`` (rotation rad, translation
            m), scaled by the inliers' own residuals; None where the problem is singular or has
            no more matches than it needs.
    """

    cam_from_world: Pose
    inliers: NDArray[np.bool_]
    covariance: NDArray[np.float64] | None


def estimate_absolute_pose(
    xy: NDArray[np.float64],
    xyz: NDArray[np.float64],
    camera: Camera,
    max_error: float,
    position: NDArray[np.float64] | None = None,
    position_sigma: NDArray[np.float64] | None = None,
    seed: int = 0,
) -> PnpResult | None:
    """LO-RANSAC P3P and non-linear refinement; None when no pose has support.

    Args:
        xy: (N, 2) pixels.
        xyz: (N, 3) world metres.
        camera: of the query.
        max_error: inlier threshold, pixels.
        position: (3,) camera centre measured by GNSS, world metres.
        position_sigma: (3,) its standard deviation per axis, metres, infinite where not measured;
            with it the position takes part in the refinement, weighed against the inliers' own
            residuals, unless the two contradict one another.
        seed: of the sampling; the same seed gives the same pose.
    """
    estimation = pycolmap.AbsolutePoseEstimationOptions()
    estimation.ransac.max_error = max_error
    estimation.ransac.random_seed = seed
    refinement = pycolmap.AbsolutePoseRefinementOptions()
    native = native_camera(camera)
    answer = pycolmap.estimate_and_refine_absolute_pose(xy, xyz, native, estimation, refinement)
    if answer is None:
        return None
    inliers = np.asarray(answer["inlier_mask"], bool)
    pose = pose_from_native(answer["cam_from_world"])
    variance = _residual_variance(xy[inliers], xyz[inliers], camera, pose)
    # Again with a loss, and with a position, weighed by the noise the matches turned out to have.
    refinement.loss_function_scale = CAUCHY * np.sqrt(variance)
    sigma = None
    if position is not None and position_sigma is not None:
        sigma = np.clip(position_sigma, _LEAST_SIGMA, _LARGEST_SIGMA)
        alone = _pose_covariance(xyz[inliers], camera, pose, variance, None)
        if alone is not None and _contradicts(pose, alone, position, sigma):
            sigma = None
    if sigma is not None:
        refinement.use_position_prior = True
        refinement.position_prior_in_world = position
        # COLMAP takes every residual to be one pixel: in that unit sigma is smaller or larger.
        refinement.position_prior_covariance = np.diag(sigma**2) / variance
    refined = pycolmap.refine_absolute_pose(
        answer["cam_from_world"], xy, xyz, inliers, native, refinement
    )
    if refined is not None:
        pose = pose_from_native(refined["cam_from_world"])
    covariance = None
    if inliers.sum() > _MINIMAL:
        covariance = _pose_covariance(xyz[inliers], camera, pose, variance, sigma)
    return PnpResult(pose, inliers, covariance)


def _pose_covariance(
    xyz: NDArray[np.float64],
    camera: Camera,
    pose: Pose,
    variance: float,
    position_sigma: NDArray[np.float64] | None,
) -> NDArray[np.float64] | None:
    """Inverse of the information of the inliers and of the position; None where singular.

    COLMAP's own covariance takes residuals to be one pixel and counts those that the robust loss
    plays down for less, so that it is honest at no other noise.
    """
    local = pose.transform(torch.from_numpy(xyz))
    projected = camera.project(local, jacobian=True).jacobian
    assert projected is not None
    jacobian = (projected @ transform_jacobian(local)).reshape(-1, 6).numpy()
    information = jacobian.T @ jacobian / variance
    if position_sigma is not None:
        # The centre moves by -R^T v.
        rotation = pose.rotation.numpy()
        information[3:, 3:] += rotation @ np.diag(position_sigma**-2) @ rotation.T
    if np.linalg.cond(information) > _SINGULAR:
        return None
    return np.asarray(np.linalg.inv(information))


def _contradicts(
    pose: Pose,
    covariance: NDArray[np.float64],
    position: NDArray[np.float64],
    sigma: NDArray[np.float64],
) -> bool:
    """Whether a pose and a measured position cannot both be true: least squares would settle on a
    place that is neither."""
    rotation = pose.rotation.numpy()
    off = pose.centre().numpy() - position
    spread = rotation.T @ covariance[3:, 3:] @ rotation + np.diag(sigma**2)
    return float(off @ np.linalg.solve(spread, off)) > _CONTRADICTS


def _residual_variance(
    xy: NDArray[np.float64], xyz: NDArray[np.float64], camera: Camera, pose: Pose
) -> float:
    """Variance of one pixel coordinate, from the inliers."""
    projected = camera.project(pose.transform(torch.from_numpy(xyz))).xy.numpy()
    degrees_of_freedom = max(2 * len(xy) - 6, 1)
    return max(float(((projected - xy) ** 2).sum() / degrees_of_freedom), LEAST_VARIANCE)
