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

from benchmark.auditing.agreement import errors, rays_of
from benchmark.auditing.findings import Finding, right, unknown, wrong
from benchmark.auditing.matches import Pair
from objconnect.scene.geometry.camera import MODELS, Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.robust import CAUCHY, SIGMA_OF_MEDIAN
from objconnect.scene.geometry.sampson import Matches
from objconnect.scene.storage.images import Exif

Array = NDArray[np.float64]

FOCAL = "focal lengths fit the photographs"
PRINCIPAL = "principal points fit the photographs"

# A focal length fits if its relative error is below the first value, and contradicts EXIF if the
# relative difference is above the second.
_FOCAL_FITS = 0.01
_EXIF_FITS = 0.15
# A shift counts as half a pixel if its standard error is below the first value and it lies within
# the second of ±0.5 px.
_HALF_SIGMA, _HALF_MET = 0.1, 0.15
# Error within which a principal point fits: pixels, or in large pictures a share of their side.
_PRINCIPAL_FITS, _PRINCIPAL_SHARE = 1.0, 1e-3
_SIGMAS = 5.0
# Iterations of Gauss-Newton, and the steps of its differences (log focal length, px, px).
_ITERATIONS = 8
_STEPS = (1e-4, 1e-2, 1e-2)
_LARGEST_STEP = (-0.1, -20, -20), (0.1, 20, 20)
_CONVERGED = (1e-4, 1e-2, 1e-2)
_LEAST_SIGMA = 0.02
# Matches with an initial error above this many thresholds are left out.
_FAR = 12.0
# Largest number of matches used of a pair, and the fewest pairs.
_PER_PAIR = 150
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


def correction(
    pairs: Sequence[Pair], cameras: Sequence[Camera | None], poses: Array
) -> Correction | None:
    """Fit the correction of all cameras; None with too few pairs.

    Args:
        pairs: matches.
        cameras: stated cameras of all photographs.
        poses: cam_from_world (N, 4, 4), in the convention that agrees with the photographs.
    """
    near = []
    for rays in rays_of(pairs, cameras):
        pair, kept = rays.pair, np.flatnonzero(errors(rays, poses) < _FAR * rays.threshold)
        if len(kept):
            few = kept[:: 1 + len(kept) // _PER_PAIR]
            near.append(Pair(pair.first, pair.second, pair.xy_first[few], pair.xy_second[few]))
    if len(near) < _LEAST_PAIRS:
        return None
    values = np.zeros(3)
    for _ in range(_ITERATIONS):
        residuals, jacobians = _linearise(near, cameras, poses, values)
        hessian, gradients = _normal(residuals, jacobians)
        step = -np.linalg.solve(hessian, gradients.sum(0))
        values += np.clip(step, *_LARGEST_STEP)
        if (np.abs(step) < _CONVERGED).all():
            break
    hessian, gradients = _normal(residuals, jacobians)
    inverse = np.linalg.inv(hessian)
    sigma = np.sqrt(np.diag(inverse @ (gradients.T @ gradients) @ inverse))
    focal = float(np.exp(values[0]))
    return Correction(focal, float(sigma[0] * focal), values[1:], sigma[1:])


def _residuals(
    pairs: Sequence[Pair], cameras: Sequence[Camera | None], poses: Array, values: Array
) -> list[Array]:
    corrected = [
        None
        if camera is None
        else correct_camera(camera, float(np.exp(values[0])), values[1:].tolist())
        for camera in cameras
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
    pairs: Sequence[Pair], cameras: Sequence[Camera | None], poses: Array, values: Array
) -> tuple[list[Array], list[Array]]:
    """Return the errors (K,) of each pair and their derivatives (K, 3), by differences."""
    here = _residuals(pairs, cameras, poses, values)
    columns = []
    for k, step in enumerate(_STEPS):
        ahead = _residuals(pairs, cameras, poses, values + np.eye(3)[k] * step)
        columns.append([(there - now) / step for there, now in zip(ahead, here, strict=True)])
    return here, [np.stack(parts, -1) for parts in zip(*columns, strict=True)]


def _normal(residuals: Sequence[Array], jacobians: Sequence[Array]) -> tuple[Array, Array]:
    """Return the matrix (3, 3) of the normal equations and the gradient (P, 3) of each pair."""
    every = np.abs(np.concatenate(residuals))
    sigma = max(SIGMA_OF_MEDIAN * float(np.median(every)), _LEAST_SIGMA)
    weights = [1 / (1 + (r / (CAUCHY * sigma)) ** 2) for r in residuals]
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
        fitted: correction that fits the matches; None with too few pairs.
        cameras: stated cameras.
        exif: metadata of the photographs.
    """
    stated = [camera for camera in cameras if camera is not None]
    if not stated:
        yield unknown(FOCAL, "the data set states no camera")
        return
    yield _check_focal(fitted, cameras, exif)
    yield _check_principal(fitted, max(max(camera.width, camera.height) for camera in stated))


def _check_focal(
    fitted: Correction | None, cameras: Sequence[Camera | None], exif: Sequence[Exif | None]
) -> Finding:
    if fitted is not None:
        off, sigma = fitted.focal - 1, fitted.focal_sigma
        figures = {"factor": fitted.focal, "sigma": sigma}
        if abs(off) > max(_FOCAL_FITS, _SIGMAS * sigma) and sigma < _EXIF_FITS / _SIGMAS:
            detail = f"{1 / fitted.focal:.4f} times that of the matches (±{sigma:.2g})"
            return wrong(FOCAL, "focal-length", detail, **figures)
        if 2 * sigma < 2 * _FOCAL_FITS:
            return right(FOCAL, f"within {abs(off):.2%} of the best (±{sigma:.2%})", **figures)
    ratios = [
        max(camera.focal) / (tags.focal_ratio * max(camera.width, camera.height))
        for camera, tags in zip(cameras, exif, strict=False)
        if camera is not None and tags is not None and tags.focal_ratio is not None
    ]
    if not ratios:
        return unknown(FOCAL, "neither matches nor EXIF determine them")
    ratio = float(np.median(ratios))
    if abs(ratio - 1) > _EXIF_FITS:
        return wrong(FOCAL, "focal-length", f"{ratio:.3f} times EXIF's", exif_ratio=ratio)
    return right(FOCAL, f"{ratio:.3f} times EXIF's, which is nominal", exif_ratio=ratio)


def _check_principal(fitted: Correction | None, side: int) -> Finding:
    why = "the flight does not determine them: it needs views in several directions"
    if fitted is None:
        return unknown(PRINCIPAL, why)
    shift, sigma = fitted.shift, fitted.shift_sigma
    best = f"best at {shift[0]:+.2f}, {shift[1]:+.2f} px (±{sigma[0]:.2f}, {sigma[1]:.2f})"
    figures = {"x_px": float(shift[0]), "y_px": float(shift[1]), "sigma_px": float(sigma.max())}
    half = np.round(shift * 2) / 2
    is_half = bool((np.abs(half) <= 0.5).all() and half.any())
    met = bool((np.abs(shift - half) < _HALF_MET).all() and (sigma < _HALF_SIGMA).all())
    if is_half and met and float((np.abs(shift) / sigma).max()) > _SIGMAS:
        where = "low" if half.sum() > 0 else "high"
        detail = (
            f"half a pixel {where}: one program counts pixels from the centre of the first pixel "
            f"and the other from its corner (COLMAP); {best}"
        )
        return wrong(PRINCIPAL, "half-pixel", detail, **figures)
    far = max(_PRINCIPAL_FITS, _PRINCIPAL_SHARE * side)
    if bool((np.abs(shift) > np.maximum(far, _SIGMAS * sigma)).any()):
        return wrong(PRINCIPAL, "principal-point", best, **figures)
    if bool((sigma < far / 2).all()):
        return right(PRINCIPAL, best, **figures)
    return unknown(PRINCIPAL, f"{why}; {best}", **figures)
