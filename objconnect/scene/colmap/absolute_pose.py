"""The pose of a camera from 2D-3D matches (PnP), and its covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap
import torch
from numpy.typing import NDArray

from objconnect.scene.colmap.native import LEAST_VARIANCE, native_camera, pose_from_native
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.correlation import estimate_correlation
from objconnect.scene.geometry.pose import Pose, transform_jacobian
from objconnect.scene.geometry.robust import CAUCHY_SCALE, MAX_CONDITION
from objconnect.scene.localizer import Prior

# Three matches determine a pose exactly: their residuals carry no information on its accuracy.
_MINIMAL_MATCHES = 3


# Squared Mahalanobis distance (three degrees of freedom) beyond which a measured position
# contradicts the matches: its probability is one in ten billion.
_MAX_SQUARED_DISTANCE = 50.0

# Standard deviations of a position (m) are clipped to this range: no GNSS is more accurate than the
# lower bound, and the upper bound has no influence, like an infinite value.
_LEAST_SIGMA = 1e-3
_LARGEST_SIGMA = 1e6


@dataclass(frozen=True)
class PnpResult:
    """A pose estimated from 2D-3D matches.

    Attributes:
        cam_from_world: pose refined on the inliers.
        inliers: (N,) bool.
        covariance: (6, 6), of the left tangent of ``cam_from_world`` (rotation rad, translation m),
            scaled by the variance and the spatial correlation of the inliers' residuals; None if
            the problem is singular or has only the minimal number of matches.
    """

    cam_from_world: Pose
    inliers: NDArray[np.bool_]
    covariance: NDArray[np.float64] | None


@dataclass(frozen=True)
class _Matches:
    """Inliers: pixels (N, 2), points (N, 3), camera, and correlation length of errors (pixels)."""

    xy: NDArray[np.float64]
    xyz: NDArray[np.float64]
    camera: Camera
    reach: float


# More than six parameters: the last two are options of ``PnpConfig``.
def estimate_absolute_pose(
    xy: NDArray[np.float64],
    xyz: NDArray[np.float64],
    camera: Camera,
    max_error: float,
    prior: Prior | None = None,
    seed: int = 0,
    error_reach: float = 0.0,
) -> PnpResult | None:
    """Estimate a pose by LO-RANSAC P3P and non-linear refinement; None if no pose has support.

    Args:
        xy: (N, 2) pixels.
        xyz: (N, 3) world metres.
        camera: camera of the query.
        max_error: inlier threshold, pixels.
        prior: measured position with standard deviations per axis, infinite if not measured. The
            refinement uses it, weighted against the residuals of the inliers, unless it contradicts
            them. It ignores a prior without standard deviations, and the attitude.
        seed: random seed of the sampling; the same seed gives the same pose.
        error_reach: distance within which errors of matches may be correlated, as a share of the
            image's longest side; 0 assumes independent errors.
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
    reach = error_reach * max(camera.width, camera.height)
    matches = _Matches(xy[inliers], xyz[inliers], camera, reach)
    variance = _residual_variance(matches, pose)
    # Refine again, with a robust loss and the position, both scaled by the measured pixel noise.
    refinement.loss_function_scale = CAUCHY_SCALE * np.sqrt(variance)
    sigma = None
    if prior is not None and prior.position_sigma is not None:
        sigma = np.clip(prior.position_sigma, _LEAST_SIGMA, _LARGEST_SIGMA)
        covariance_of_matches = _pose_covariance(matches, pose, variance, None)
        if covariance_of_matches is not None and _contradicts(
            pose, covariance_of_matches, prior.position, sigma
        ):
            sigma = None
    if prior is not None and sigma is not None:
        refinement.use_position_prior = True
        refinement.position_prior_in_world = prior.position
        # COLMAP assumes residuals of one pixel, so it takes covariances in units of their variance.
        refinement.position_prior_covariance = np.diag(sigma**2) / variance
    refined = pycolmap.refine_absolute_pose(
        answer["cam_from_world"], xy, xyz, inliers, native, refinement
    )
    if refined is not None:
        pose = pose_from_native(refined["cam_from_world"])
    covariance = None
    if inliers.sum() > _MINIMAL_MATCHES:
        covariance = _pose_covariance(matches, pose, variance, sigma)
    return PnpResult(pose, inliers, covariance)


def _pose_covariance(
    matches: _Matches,
    pose: Pose,
    variance: float,
    position_sigma: NDArray[np.float64] | None,
) -> NDArray[np.float64] | None:
    """Return the covariance of least squares over inliers and position; None if singular.

    It is a sandwich of the inverse information with the contribution of correlated neighbours
    (``geometry.correlation``). COLMAP's own covariance assumes residuals of one pixel and
    downweights those that the robust loss reduces, so it is wrong for any other noise.
    """
    local = pose.transform(torch.from_numpy(matches.xyz))
    projected = matches.camera.project(local, jacobian=True)
    assert projected.jacobian is not None
    jacobian = (projected.jacobian @ transform_jacobian(local)).numpy()
    flat = jacobian.reshape(-1, 6)
    information = flat.T @ flat / variance
    if position_sigma is not None:
        # To first order the centre moves by -R^T v.
        rotation = pose.rotation.numpy()
        information[3:, 3:] += rotation @ np.diag(position_sigma**-2) @ rotation.T
    if np.linalg.cond(information) > MAX_CONDITION:
        return None
    residuals = projected.xy.numpy() - matches.xy
    neighbours = estimate_correlation(matches.xy, residuals, jacobian, matches.reach)
    inverse = np.linalg.inv(information)
    added = neighbours.correlation * neighbours.information / variance
    covariance = inverse + inverse @ added @ inverse
    return np.asarray((covariance + covariance.T) / 2)


def _contradicts(
    pose: Pose,
    covariance: NDArray[np.float64],
    position: NDArray[np.float64],
    sigma: NDArray[np.float64],
) -> bool:
    """Return whether a pose and a measured position contradict each other.

    Least squares over both would then give a position between the two.
    """
    rotation = pose.rotation.numpy()
    difference = pose.centre().numpy() - position
    total = rotation.T @ covariance[3:, 3:] @ rotation + np.diag(sigma**2)
    return float(difference @ np.linalg.solve(total, difference)) > _MAX_SQUARED_DISTANCE


def _residual_variance(matches: _Matches, pose: Pose) -> float:
    """Return the variance of one pixel coordinate (px^2) of the inliers."""
    local = pose.transform(torch.from_numpy(matches.xyz))
    projected = matches.camera.project(local).xy.numpy()
    degrees_of_freedom = max(2 * len(matches.xy) - 6, 1)
    squares = float(((projected - matches.xy) ** 2).sum())
    return max(squares / degrees_of_freedom, LEAST_VARIANCE)
