"""Georegister a model of unknown frame and scale by GPS with outliers.

Similarities are (3, 4) arrays: scale times rotation, and translation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.robust import SIGMA_OF_MEDIAN
from objconnect.scene.maps.sparse_map import SparseMap

Array = NDArray[np.float64]
_Fit = Callable[[Array, Array], Array]

BLUNDER_SIGMAS: Final = 5.0
"""A fix is an outlier if its residual exceeds this many standard deviations of the others, and
``USUAL_ERROR_M``. The factor is large because drift makes the tails of a receiver's errors long."""

USUAL_ERROR_M: Final = 5.0
"""Usual error (m) of receivers without RTK. Fixes with smaller residuals are not outliers."""

MIN_SIGMA_M: Final = 0.02
"""Lower bound (m) of position standard deviations, the accuracy of an RTK receiver."""

# Random samples of least median of squares. If half of the fixes are wrong, the probability that no
# sample of three is right is (7/8)^500, about 1e-29.
_SAMPLES: Final = 500
# Minimum ratio of the width of a flight to its length. The positions of a narrower flight do not
# determine the rotation about its direction.
_MIN_WIDTH: Final = 0.05
# GPS altitudes are rejected if ground and cameras agree with each other, and differ by more than
# this from the vertical of GPS.
_MAX_TILT_DEG: Final = 8.0
# Points further from the plane of the ground than this many standard deviations are not ground.
_GROUND_SIGMAS: Final = 2.5
# Minimum number of altitudes that determine a rotation.
_MIN_ALTITUDES: Final = 3
# Median of the chi-squared distribution, by its degrees of freedom.
_CHI2_MEDIAN = {2: 1.386, 3: 2.366}


@dataclass(frozen=True)
class Georegistration:
    """The position, rotation and scale of a model in the world.

    Attributes:
        world_from_model: Similarity (3, 4).
        level: What defines the vertical: "gps", the "ground" where altitudes are unusable or the
            flight is straight, imported poses ("given"), control points ("control"), or the map
            of the scene that photographs were added to ("map").
        blunders: Photographs whose fix is an outlier.
        sigma: Standard deviation (3,) of the other fixes per axis, metres.
    """

    world_from_model: Array
    level: str
    blunders: tuple[str, ...]
    sigma: Array

    def apply(self, points: Array) -> Array:
        """Return points (N, 3) of the model in world coordinates."""
        return _apply(self.world_from_model, points)


def georegister(model: SparseMap, fixes: Mapping[str, Array]) -> Georegistration:
    """Estimate the similarity from camera centres to GPS by least median of squares.

    The estimate tolerates up to half of the fixes being wrong, and needs no threshold that depends
    on the receiver. Altitudes are used unless both the ground (the plane near most points) and the
    mean direction of the cameras contradict them, as with a barometer that drifts. In that case,
    and where the cameras are on one line, the ground is assumed to be level. A hillside is not
    mistaken for a tilt, because the cameras over it look straight down.

    Args:
        model: The model, in its own frame.
        fixes: Measured camera centres (3,) by name, east, north, up in metres.

    Raises:
        InputError: Fewer than three photographs of the model have a fix, or all fixes are equal.
    """
    names = [name for name in model.names if name in fixes]
    if len(names) < 3:
        raise InputError(
            f"only {len(names)} of the {len(model.names)} registered photographs have a GPS "
            "position, georegistration needs three: give --gps"
        )
    centres = np.array([model.images[name].centre for name in names])
    measured = np.array([fixes[name] for name in names])
    has_altitude = np.isfinite(measured[:, 2])
    offsets = measured - np.median(measured, 0)
    offsets[:, 2] = (
        measured[:, 2] - np.median(measured[has_altitude, 2]) if has_altitude.any() else 0.0
    )
    if np.linalg.norm(np.nan_to_num(offsets), axis=1).max() < MIN_SIGMA_M:
        raise InputError("all GPS positions are equal: scale and direction are unknown; give --gps")

    upright = _level_rotation(model)
    level = "ground"
    if has_altitude.sum() >= _MIN_ALTITUDES and not is_on_a_line(centres[has_altitude]):
        similarity, good = _fit_with_altitudes(centres, measured)
        if _tilt_deg(similarity, model, upright[2]) <= _MAX_TILT_DEG:
            level = "gps"
    if level == "ground":
        similarity, good = _fit_level(upright, centres, measured)
    residuals = (_apply(similarity, centres) - measured)[good]
    return Georegistration(
        world_from_model=similarity,
        level=level,
        blunders=tuple(name for name, ok in zip(names, good, strict=True) if not ok),
        sigma=np.maximum(rms_of(residuals), MIN_SIGMA_M),
    )


def rms_of(differences: Array) -> Array:
    """Return the root mean square (3,) of differences (N, 3); vertical ones may be NaN.

    The vertical root mean square is infinite where all vertical differences are NaN.
    """
    has_altitude = np.isfinite(differences[:, 2])
    if has_altitude.all():
        return np.asarray(np.sqrt((differences**2).mean(0)))
    vertical = differences[has_altitude, 2]
    up = float(np.sqrt((vertical**2).mean())) if len(vertical) else np.inf
    return np.array([*np.sqrt((differences[:, :2] ** 2).mean(0)), up])


def _fit_with_altitudes(centres: Array, measured: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Fit to the fixes with an altitude, and classify the others by their horizontal residuals."""
    has_altitude = np.isfinite(measured[:, 2])
    similarity, inliers = fit_robust_similarity(centres[has_altitude], measured[has_altitude])
    distance = np.linalg.norm((_apply(similarity, centres) - measured)[:, :2], axis=1)
    sigma = SIGMA_OF_MEDIAN * float(np.median(distance[has_altitude][inliers]))
    good = distance <= max(BLUNDER_SIGMAS * sigma, USUAL_ERROR_M)
    good[has_altitude] = inliers
    return similarity, good


def _apply(similarity: Array, points: Array) -> Array:
    return np.asarray(points @ similarity[:, :3].T + similarity[:, 3])


def _tilt_deg(similarity: Array, model: SparseMap, ground: Array) -> float:
    """Return the angle by which a similarity's vertical contradicts the ground and the cameras.

    It is the smaller of the angles to the ground's normal and to the cameras' mean backward axis,
    or 0 if the angle between these two is larger.

    Args:
        similarity: Similarity from GPS with its altitudes.
        model: The model, in its own frame.
        ground: Upward normal (3,) of the ground, in that frame.
    """
    vertical = similarity[2, :3]
    backwards = -np.sum([model.images[name].cam_from_world[2, :3] for name in model.names], axis=0)
    disagreement = _angle_deg(ground, backwards)
    tilt = min(_angle_deg(vertical, ground), _angle_deg(vertical, backwards))
    return tilt if tilt > disagreement else 0.0


def _angle_deg(a: Array, b: Array) -> float:
    cosine = a @ b / (np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def is_on_a_line(points: Array) -> bool:
    """Return whether points (N, 3) are too near one line to determine the rotation about it."""
    singular = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return bool(singular[1] < _MIN_WIDTH * max(singular[0], 1e-12))


def fit_robust_similarity(
    source: Array, target: Array, usual_error_m: float = USUAL_ERROR_M
) -> tuple[Array, NDArray[np.bool_]]:
    """Fit a similarity to points (N, 3) of which up to half are outliers.

    Args:
        source: Points (N, 3).
        target: Their positions (N, 3) in the target frame, metres.
        usual_error_m: Points with a smaller residual are inliers.

    Returns:
        The similarity (3, 4), and the mask (N,) of inliers.
    """
    return _fit_robust(fit_similarity, source, target, 3, usual_error_m)


def _fit_level(upright: Array, centres: Array, measured: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Fit with the ground level; heights have the scale of the horizontal fit."""
    levelled = centres @ upright.T
    horizontal, good = _fit_robust(
        _fit_level_similarity, levelled, np.nan_to_num(measured), 2, USUAL_ERROR_M
    )
    similarity = np.column_stack([horizontal[:, :3] @ upright, horizontal[:, 3]])
    up = (measured - _apply(similarity, centres))[:, 2]
    # All fixes with an altitude may be horizontal outliers.
    used = good & np.isfinite(up) if (good & np.isfinite(up)).any() else np.isfinite(up)
    if used.any():
        similarity[2, 3] += np.median(up[used])
    return similarity, good


def _fit_robust(
    fit: _Fit, source: Array, target: Array, axes: int, usual_error_m: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Fit by least median of squares over random samples, then by least squares over inliers.

    Residuals are measured along the first ``axes`` axes. Each sample has ``axes`` points.
    """
    rng = np.random.default_rng(0)
    best, least = fit(source, target), np.inf
    for _ in range(_SAMPLES):
        rows = rng.choice(len(source), axes, replace=False)
        candidate = fit(source[rows], target[rows])
        median = _median_square(candidate, source, target, axes)
        if median < least:
            best, least = candidate, median
    for _ in range(5):
        sigma = np.sqrt(_median_square(best, source, target, axes) / _CHI2_MEDIAN[axes])
        distance = np.linalg.norm((_apply(best, source) - target)[:, :axes], axis=1)
        good = distance <= max(BLUNDER_SIGMAS * float(sigma), usual_error_m)
        best = fit(source[good], target[good])
    return best, good


def _median_square(similarity: Array, source: Array, target: Array, axes: int) -> float:
    residuals = (_apply(similarity, source) - target)[:, :axes]
    return float(np.median((residuals**2).sum(1)))


def fit_similarity(source: Array, target: Array) -> Array:
    """Fit the similarity (3, 4) between points (N, 3) by least squares (Umeyama 1991)."""
    a, b = source - source.mean(0), target - target.mean(0)
    u, singular, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    scale = (singular * sign).sum() / max((a**2).sum(), 1e-12)
    linear = scale * (u * sign) @ vt
    return np.column_stack([linear, target.mean(0) - linear @ source.mean(0)])


def _fit_level_similarity(source: Array, target: Array) -> Array:
    """Fit the horizontal axes alone by least squares, with a rotation about the vertical."""
    a, b = (x[:, 0] + 1j * x[:, 1] for x in (source - source.mean(0), target - target.mean(0)))
    turn = (b * a.conj()).sum() / max((np.abs(a) ** 2).sum(), 1e-12)
    linear = np.array([[turn.real, -turn.imag, 0], [turn.imag, turn.real, 0], [0, 0, np.abs(turn)]])
    return np.column_stack([linear, target.mean(0) - linear @ source.mean(0)])


def _level_rotation(model: SparseMap) -> Array:
    """Return the rotation (3, 3) that makes the ground level and puts the cameras above it."""
    points = model.xyz
    is_ground = np.ones(len(points), bool)
    for _ in range(10):
        middle = points[is_ground].mean(0)
        normal = np.linalg.svd(points[is_ground] - middle, full_matrices=False)[2][2]
        distance = np.abs((points - middle) @ normal)
        is_ground = distance <= _GROUND_SIGMAS * SIGMA_OF_MEDIAN * np.median(distance)
    if ((model.centres - middle) @ normal).mean() < 0:
        normal = -normal
    east = np.cross([0.0, 1.0, 0.0] if abs(normal[1]) < 0.9 else [1.0, 0.0, 0.0], normal)
    east /= np.linalg.norm(east)
    return np.stack([east, np.cross(normal, east), normal])
