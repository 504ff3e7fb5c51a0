"""The camera of a photograph, from the map, the maker's calibration or EXIF, or estimated."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.geometry.camera import MODELS, Camera
from objconnect.scene.localizer import Estimate, Query, Status
from objconnect.scene.quantities.film_lens import SAME_LENS
from objconnect.scene.quantities.focal import SAME_ASPECT
from objconnect.scene.storage.exif import Exif

# Relative focal lengths f / max(w, h) to try if the focal length is unknown: 90 to 37 degrees of
# view.
_RELATIVE_FOCALS: Final = (0.5, 0.6, 0.72, 0.86, 1.04, 1.24, 1.5)
# Relative standard deviation of the focal length of an estimated pinhole camera
# (docs/evidence/robustness.md has an example).
_PINHOLE_FOCAL_SIGMA: Final = 0.06
# Relative standard deviation of the focal length if the estimated camera is a camera of the map.
_MAP_FOCAL_SIGMA: Final = 0.005
# Relative standard deviation of the focal length in EXIF, which is rounded and not calibrated. In
# two real flights it is 0.9 and 2.8 % shorter than the calibrated one.
_EXIF_FOCAL_SIGMA: Final = 0.03
# Maximum number of map points from which the distance to the ground is computed.
_MAX_POINTS: Final = 20_000
# Rotation sigma of a camera with which localization fails, as a multiple of the largest sigma of
# the cameras with which it succeeds.
_FAILED_SIGMA: Final = 2.0


class CameraSource(StrEnum):
    """The source of a photograph's camera."""

    GIVEN = "given"  # by the user
    MAP = "map"  # a camera of the map
    CALIBRATED = "calibrated"  # the maker's calibration in XMP
    SCALED = "scaled"  # a camera of the map, resized
    EXIF = "exif"  # a pinhole with the focal length in EXIF
    ESTIMATED = "estimated"  # the candidate that fits the map best


@dataclass(frozen=True)
class Calibration:
    """The camera of a photograph and its source.

    Attributes:
        camera: the camera; the first candidate if the camera must be estimated.
        source: source of the camera.
        others: further candidates; empty unless the camera must be estimated.
    """

    camera: Camera
    source: CameraSource
    others: tuple[Camera, ...] = ()


def calibration_of(size: tuple[int, int], exif: Exif, cameras: Collection[Camera]) -> Calibration:
    """Return the camera of a photograph for which the user gives none.

    The first that exists is used: the map's camera of the photograph's size; the calibration in
    XMP; the map's camera of another size, scaled; a pinhole with the focal length in EXIF. A camera
    of the map is used only if its focal length agrees with EXIF, or if EXIF has no focal length and
    the map has a single camera of the photograph's size. If none of these exists, or if fields of
    EXIF contradict each other, the camera must be estimated against the map.

    Args:
        size: width and height of the photograph, pixels.
        exif: metadata of the photograph.
        cameras: cameras of the map.
    """
    if exif.focals:
        return _candidates(size, exif.focals, cameras)
    same_aspect = [c for c in cameras if _same_aspect((c.width, c.height), size)]
    same_aspect.sort(key=lambda camera: (_difference_from_exif(camera, exif), str(camera)))
    same_size = [camera for camera in same_aspect if (camera.width, camera.height) == size]
    if same_size and (
        _difference_from_exif(same_size[0], exif) < SAME_LENS
        or (exif.relative_focal is None and len(same_size) == 1)
    ):
        return Calibration(same_size[0], CameraSource.MAP)
    calibrated = exif.xmp.camera
    if calibrated is not None and _same_aspect((calibrated.width, calibrated.height), size):
        return Calibration(_fit_to_size(calibrated, size), CameraSource.CALIBRATED)
    if same_aspect and _difference_from_exif(same_aspect[0], exif) < SAME_LENS:
        return Calibration(_fit_to_size(same_aspect[0], size), CameraSource.SCALED)
    focal = exif.relative_focal
    if focal is not None:
        return Calibration(_pinhole(size, focal), CameraSource.EXIF)
    candidates = [_fit_to_size(camera, size) for camera in same_aspect]
    candidates += [_pinhole(size, focal) for focal in _RELATIVE_FOCALS]
    return Calibration(candidates[0], CameraSource.ESTIMATED, tuple(candidates[1:]))


def _candidates(
    size: tuple[int, int], focals: Sequence[float], cameras: Collection[Camera]
) -> Calibration:
    """Return candidate cameras of a photograph whose EXIF fields contradict each other.

    Each relative focal length gives a pinhole camera. If it agrees with a camera of the map, that
    camera is a candidate too. Candidates that agree with a camera of the map come first.

    Args:
        size: width and height of the photograph, pixels.
        focals: relative focal lengths f / max(w, h) by the contradicting fields.
        cameras: cameras of the map.
    """
    same_aspect = sorted(
        (camera for camera in cameras if _same_aspect((camera.width, camera.height), size)), key=str
    )
    candidates: list[Camera] = []
    for focal in sorted(focals, key=lambda each: not _find_nearest(each, same_aspect)):
        camera = _find_nearest(focal, same_aspect)
        candidates += [] if camera is None else [_fit_to_size(camera, size)]
        candidates.append(_pinhole(size, focal))
    candidates = list(dict.fromkeys(candidates))
    return Calibration(candidates[0], CameraSource.ESTIMATED, tuple(candidates[1:]))


def _find_nearest(focal: float, cameras: Sequence[Camera]) -> Camera | None:
    """Return the camera of nearest relative focal length; None if it is not of the same lens."""
    difference = {camera: _relative_difference(camera, focal) for camera in cameras}
    best = min(difference, key=lambda camera: difference[camera], default=None)
    return best if best is not None and difference[best] < SAME_LENS else None


def _relative_difference(camera: Camera, focal: float) -> float:
    """Return the relative difference of a camera's focal length from ``focal`` (f / max(w, h))."""
    ratio = camera.focal[0] / max(camera.width, camera.height) / focal
    return max(ratio, 1 / ratio) - 1


def estimate_camera(
    cameras: Sequence[Camera], queries: Iterable[Query], localize: Callable[[Query], Estimate]
) -> Camera:
    """Return the camera with which photographs of one lens fit a map best.

    The misfit of a photograph is the logarithm of the standard deviation of its rotation about the
    optical axis, weighted by the number of inliers. This standard deviation grows with the
    residuals of the inliers but, unlike the deviation of the position, not with the focal length.
    The misfits of photographs are added like log-likelihoods. Between neighbouring pinholes, a
    parabola through the misfits interpolates the focal length.

    Args:
        cameras: candidates (``calibration_of``). Pinholes of ``_RELATIVE_FOCALS`` come last,
            in increasing order of focal length.
        queries: photographs of the lens.
        localize: localizes a query.
    """
    misfit = np.zeros(len(cameras))
    for query in queries:
        estimates = [localize(replace(query, camera=camera)) for camera in cameras]
        sigmas = np.array([_rotation_sigma(estimate) for estimate in estimates])
        found = np.isfinite(sigmas)
        if found.any():
            sigmas[~found] = _FAILED_SIGMA * sigmas[found].max()
            misfit += max(estimate.inliers for estimate in estimates) * np.log(sigmas)
    best = int(misfit.argmin())
    first = len(cameras) - len(_RELATIVE_FOCALS)
    size = cameras[0].width, cameras[0].height
    has_pinholes = first >= 0 and cameras[first] == _pinhole(size, _RELATIVE_FOCALS[0])
    if not has_pinholes or not first < best < len(cameras) - 1:
        return cameras[best]
    near = slice(best - 1, best + 2)
    focals = np.log([camera.focal[0] for camera in cameras[near]])
    curve, slope, _ = np.polyfit(focals - focals[1], misfit[near], 2)
    camera = cameras[best]
    factor = math.exp(-slope / (2 * curve)) if curve > 0 else 1.0
    return _rescale(camera, (camera.width, camera.height), factor, 1.0, 0.0)


def focal_sigma(camera: Camera, source: CameraSource, cameras: Collection[Camera]) -> float:
    """Return the relative standard deviation of a focal length.

    It is 0 for a camera that was calibrated, by the user, the maker or the map.

    Args:
        camera: the camera of a photograph.
        source: its source.
        cameras: cameras of the map.
    """
    if source is CameraSource.EXIF:
        return _EXIF_FOCAL_SIGMA
    if source is not CameraSource.ESTIMATED:
        return 0.0
    size = (camera.width, camera.height)
    is_map_camera = any(
        _same_aspect((c.width, c.height), size) and _fit_to_size(c, size) == camera for c in cameras
    )
    return _MAP_FOCAL_SIGMA if is_map_camera else _PINHOLE_FOCAL_SIGMA


def add_focal_error(
    estimate: Estimate, camera: Camera, relative_sigma: float, xyz: NDArray[np.float64]
) -> Estimate:
    """Return an estimate whose covariance includes the error of the focal length.

    A relative error of the focal length causes the same relative error of the camera's distance
    from the ground.

    Args:
        estimate: pose that was computed with the camera.
        camera: the camera.
        relative_sigma: relative standard deviation of its focal length (``focal_sigma``).
        xyz: points (N, 3) of the map, world metres.
    """
    pose, covariance = estimate.cam_from_world, estimate.covariance
    if pose is None or covariance is None or relative_sigma == 0:
        return estimate
    rotation, translation = pose.rotation.numpy(), pose.translation.numpy()
    sampled = xyz[:: 1 + len(xyz) // _MAX_POINTS] @ rotation.T + translation
    half = np.array([camera.width, camera.height]) / 2 / camera.focal[0]
    seen = (sampled[:, 2] > 0) & (np.abs(sampled[:, :2]) <= half * sampled[:, 2:]).all(1)
    if not seen.any():
        return estimate
    enlarged = covariance.copy()
    enlarged[5, 5] += (relative_sigma * float(np.median(sampled[seen, 2]))) ** 2
    return replace(estimate, covariance=enlarged)


def _rotation_sigma(estimate: Estimate) -> float:
    """Return the standard deviation of the rotation about the optical axis, rad; infinite on
    failure."""
    if estimate.status is not Status.OK:
        return math.inf
    variance = math.nan if estimate.covariance is None else float(estimate.covariance[2, 2])
    # Without a covariance, the number of inliers gives the sigma up to a factor.
    return math.sqrt(variance if variance > 0 else 1 / max(estimate.inliers, 1))


def _difference_from_exif(camera: Camera, exif: Exif) -> float:
    """Return the relative difference of a camera's focal length from EXIF; infinite if unknown."""
    focal = exif.relative_focal
    return math.inf if focal is None else _relative_difference(camera, focal)


def _same_aspect(first: tuple[int, int], second: tuple[int, int]) -> bool:
    return abs(first[0] * second[1] / (first[1] * second[0]) - 1) < SAME_ASPECT


def _fit_to_size(camera: Camera, size: tuple[int, int]) -> Camera:
    """Return the camera of a resized image; the aspect ratio may differ slightly."""
    scale = size[0] / camera.width
    return _rescale(camera, size, scale, scale, (size[1] - scale * camera.height) / 2)


def _rescale(
    camera: Camera, size: tuple[int, int], focal_scale: float, centre_scale: float, shift_y: float
) -> Camera:
    """Return a camera of another size.

    Args:
        camera: the camera.
        size: width and height of the result, pixels.
        focal_scale: factor on the focal length.
        centre_scale: factor on the principal point.
        shift_y: pixels by which the principal point is then moved down.
    """
    scales = dict.fromkeys(("f", "fx", "fy"), focal_scale)
    scales |= {"cx": centre_scale, "cy": centre_scale}
    params = tuple(
        value * scales.get(name, 1.0) + (shift_y if name == "cy" else 0.0)
        for name, value in zip(MODELS[camera.model], camera.params, strict=True)
    )
    return Camera(camera.model, *size, params)


def _pinhole(size: tuple[int, int], focal: float) -> Camera:
    """Return the pinhole camera with a relative focal length f / max(w, h)."""
    return Camera("SIMPLE_PINHOLE", *size, (focal * max(size), size[0] / 2, size[1] / 2))
