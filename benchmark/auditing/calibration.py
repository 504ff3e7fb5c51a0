"""Check of focal lengths and principal points against the matches, at the stated poses.

One factor on all focal lengths and one shift of all principal points are fitted to the Sampson
errors. Their standard errors come from the scatter between pairs (a sandwich estimate), because the
matches of one pair share its errors. A straight, level flight in one direction determines neither;
the standard errors are then large.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.auditing.agreement import rays_of, sampson_errors
from benchmark.auditing.findings import Finding, right, unknown, wrong
from benchmark.auditing.matches import Pair
from objconnect.scene.geometry.camera import MODELS, Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.robust import CAUCHY_SCALE, SIGMA_OF_MEDIAN
from objconnect.scene.geometry.sampson import Matches
from objconnect.scene.storage.exif import Exif

Array = NDArray[np.float64]

FOCAL = "focal lengths fit the photographs"
PRINCIPAL = "principal points fit the photographs"

# A focal length is wrong if its relative error is significant and above the first value; otherwise
# it fits if the standard error is below this value. It contradicts EXIF if the relative difference
# is above the second.
_FOCAL_TOLERANCE = 0.01
_EXIF_TOLERANCE = 0.15
# A shift counts as half a pixel if its standard error (px) is below the first value and its
# difference from the nearest multiple of 0.5 px is below the second.
_HALF_SIGMA, _HALF_TOLERANCE = 0.1, 0.15
# A principal point is wrong if its error is significant and above a limit, the larger of this many
# pixels and this share of the longer side; otherwise it fits if the standard error is below half of
# the limit.
_PRINCIPAL_TOLERANCE_PX, _PRINCIPAL_SHARE = 1.0, 1e-3
# A deviation of more than this many standard errors is significant.
_SIGMAS = 5.0
# The fit is by Gauss-Newton. Its parameters are the logarithm of the focal factor and the shift of
# the principal points in x and y, pixels.
_ITERATIONS = 8
_DERIVATIVE_STEPS = (1e-4, 1e-2, 1e-2)  # steps of the numerical derivatives
_STEP_BOUNDS = (-0.1, -20, -20), (0.1, 20, 20)  # lowest and highest step of an iteration
_CONVERGED = (1e-4, 1e-2, 1e-2)  # the fit stops after a step below this
_MIN_SIGMA_PX = 0.02  # lower bound of the scale of the residuals
# Matches with an initial error above ``Rays.threshold`` times this are left out.
_OUTLIER_FACTOR = 12.0
# At most this many matches of a pair are used, and at least this many pairs are needed.
_MAX_PER_PAIR = 150
_LEAST_PAIRS = 4
# A ridge that keeps the step finite if the matches do not determine a parameter.
_RIDGE = 1e-9


@dataclass(frozen=True)
class Correction:
    """The correction of all cameras that fits the matches best.

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


def correct_camera(camera: Camera, focal: float, shift: Sequence[float]) -> Camera:
    """Return a camera with its focal length multiplied and its principal point moved (px)."""
    moves = {"cx": shift[0], "cy": shift[1]}
    params = tuple(
        value * focal if name in ("f", "fx", "fy") else value + moves.get(name, 0.0)
        for name, value in zip(MODELS[camera.model], camera.params, strict=True)
    )
    return replace(camera, params=params)


def fit_correction(
    pairs: Sequence[Pair], cameras: Sequence[Camera | None], poses: Array
) -> Correction | None:
    """Fit the correction of all cameras; None with too few pairs.

    Args:
        pairs: matches.
        cameras: stated cameras of all photographs.
        poses: cam_from_world (N, 4, 4), in the convention that agrees with the photographs.
    """
    inliers = []
    for rays in rays_of(pairs, cameras):
        pair = rays.pair
        agreeing = np.flatnonzero(sampson_errors(rays, poses) < _OUTLIER_FACTOR * rays.threshold)
        if len(agreeing):
            thinned = agreeing[:: 1 + len(agreeing) // _MAX_PER_PAIR]
            inliers.append(
                Pair(pair.first, pair.second, pair.xy_first[thinned], pair.xy_second[thinned])
            )
    if len(inliers) < _LEAST_PAIRS:
        return None
    parameters = np.zeros(3)
    for _ in range(_ITERATIONS):
        residuals, jacobians = _linearise(inliers, cameras, poses, parameters)
        hessian, gradients = _normal_equations(residuals, jacobians)
        step = -np.linalg.solve(hessian, gradients.sum(0))
        parameters += np.clip(step, *_STEP_BOUNDS)
        if (np.abs(step) < _CONVERGED).all():
            break
    hessian, gradients = _normal_equations(residuals, jacobians)
    inverse = np.linalg.inv(hessian)
    sigma = np.sqrt(np.diag(inverse @ (gradients.T @ gradients) @ inverse))
    focal = float(np.exp(parameters[0]))
    return Correction(focal, float(sigma[0] * focal), parameters[1:], sigma[1:])


def _residuals(
    pairs: Sequence[Pair], cameras: Sequence[Camera | None], poses: Array, parameters: Array
) -> list[Array]:
    """Return the Sampson errors (K,) of each pair, pixels, with corrected cameras."""
    focal, shift = float(np.exp(parameters[0])), parameters[1:].tolist()
    corrected = [
        None if camera is None else correct_camera(camera, focal, shift) for camera in cameras
    ]
    residuals = []
    for pair in pairs:
        a, b = corrected[pair.first], corrected[pair.second]
        assert a is not None and b is not None
        first, _ = a.unproject(torch.from_numpy(pair.xy_first))
        second, _ = b.unproject(torch.from_numpy(pair.xy_second))
        matches = Matches(Pose.from_matrix(poses[pair.first]), second, first)
        pose = Pose.from_matrix(poses[pair.second])
        error, _ = matches.residuals(pose, float(np.mean(b.focal)))
        residuals.append(np.asarray(error.numpy(), np.float64))
    return residuals


def _linearise(
    pairs: Sequence[Pair], cameras: Sequence[Camera | None], poses: Array, parameters: Array
) -> tuple[list[Array], list[Array]]:
    """Return the errors (K,) of each pair and their derivatives (K, 3) by the parameters."""
    residuals = _residuals(pairs, cameras, poses, parameters)
    columns = []
    for k, step in enumerate(_DERIVATIVE_STEPS):
        moved = _residuals(pairs, cameras, poses, parameters + np.eye(3)[k] * step)
        columns.append([(b - a) / step for a, b in zip(residuals, moved, strict=True)])
    return residuals, [np.stack(parts, -1) for parts in zip(*columns, strict=True)]


def _normal_equations(
    residuals: Sequence[Array], jacobians: Sequence[Array]
) -> tuple[Array, Array]:
    """Return the matrix (3, 3) of the normal equations and the gradient (P, 3) of each pair."""
    absolute = np.abs(np.concatenate(residuals))
    sigma = max(SIGMA_OF_MEDIAN * float(np.median(absolute)), _MIN_SIGMA_PX)
    weights = [1 / (1 + (r / (CAUCHY_SCALE * sigma)) ** 2) for r in residuals]
    hessian = _RIDGE * np.eye(3)
    gradients = np.zeros((len(residuals), 3))
    for row, (r, j, w) in enumerate(zip(residuals, jacobians, weights, strict=True)):
        hessian = hessian + (w[:, None] * j).T @ j
        gradients[row] = (w[:, None] * j).T @ r
    return hessian, gradients


def check_calibration(
    fitted: Correction | None, cameras: Sequence[Camera | None], exif: Sequence[Exif | None]
) -> Iterator[Finding]:
    """Check the stated cameras.

    Args:
        fitted: correction that fits the matches; None if the matches are too few or contradict the
            poses.
        cameras: stated cameras.
        exif: metadata of the photographs.
    """
    known_cameras = [camera for camera in cameras if camera is not None]
    if not known_cameras:
        yield unknown(FOCAL, "the data set states no camera")
        return
    yield _check_focal(fitted, cameras, exif)
    side = max(max(camera.width, camera.height) for camera in known_cameras)
    yield _check_principal(fitted, side)


def _check_focal(
    fitted: Correction | None, cameras: Sequence[Camera | None], exif: Sequence[Exif | None]
) -> Finding:
    """Check focal lengths against the matches or, if these do not determine them, against EXIF."""
    if fitted is not None:
        error, sigma = fitted.focal - 1, fitted.focal_sigma
        figures = {"factor": fitted.focal, "sigma": sigma}
        if (
            abs(error) > max(_FOCAL_TOLERANCE, _SIGMAS * sigma)
            and sigma < _EXIF_TOLERANCE / _SIGMAS
        ):
            detail = f"{1 / fitted.focal:.4f} times those that fit the matches (±{sigma:.2g})"
            return wrong(FOCAL, "focal-length", detail, **figures)
        if sigma < _FOCAL_TOLERANCE:
            return right(
                FOCAL, f"within {abs(error):.2%} of the best fit (±{sigma:.2%})", **figures
            )
    ratios = [
        max(camera.focal) / (tags.relative_focal * max(camera.width, camera.height))
        for camera, tags in zip(cameras, exif, strict=False)
        if camera is not None and tags is not None and tags.relative_focal is not None
    ]
    if not ratios:
        return unknown(FOCAL, "neither matches nor EXIF determine them")
    ratio = float(np.median(ratios))
    if abs(ratio - 1) > _EXIF_TOLERANCE:
        return wrong(FOCAL, "focal-length", f"{ratio:.3f} times those in EXIF", exif_ratio=ratio)
    return right(FOCAL, f"{ratio:.3f} times the nominal ones in EXIF", exif_ratio=ratio)


def _check_principal(fitted: Correction | None, side: int) -> Finding:
    """Check principal points; ``side`` is the longer side of the largest photograph, pixels."""
    if fitted is None:
        return unknown(PRINCIPAL, "the matches are too few or contradict the poses")
    why = "the flight does not determine them: it needs views in several directions"
    shift, sigma = fitted.shift, fitted.shift_sigma
    best = f"best shift {shift[0]:+.2f}, {shift[1]:+.2f} px (±{sigma[0]:.2f}, {sigma[1]:.2f})"
    figures = {"x_px": float(shift[0]), "y_px": float(shift[1]), "sigma_px": float(sigma.max())}
    half = np.round(shift * 2) / 2
    is_half = bool((np.abs(half) <= 0.5).all() and half.any())
    is_near_half = bool(
        (np.abs(shift - half) < _HALF_TOLERANCE).all() and (sigma < _HALF_SIGMA).all()
    )
    if is_half and is_near_half and float((np.abs(shift) / sigma).max()) > _SIGMAS:
        size = "small" if half.sum() > 0 else "large"
        detail = (
            f"their coordinates are half a pixel too {size}: one program counts pixels from the "
            f"centre of the first pixel and the other from its corner (COLMAP); {best}"
        )
        return wrong(PRINCIPAL, "half-pixel", detail, **figures)
    limit = max(_PRINCIPAL_TOLERANCE_PX, _PRINCIPAL_SHARE * side)
    if bool((np.abs(shift) > np.maximum(limit, _SIGMAS * sigma)).any()):
        return wrong(PRINCIPAL, "principal-point", best, **figures)
    if bool((sigma < limit / 2).all()):
        return right(PRINCIPAL, best, **figures)
    return unknown(PRINCIPAL, f"{why}; {best}", **figures)
