"""Agreement of poses with the matches between photographs, as stated and in other conventions.

Other conventions of poses are, for example, inverted matrices or the camera axes of OpenGL.

A match agrees if its Sampson error is small and its point lies in front of both cameras. Neither a
rigid motion of the world nor its scale changes this, so that poses in any world can be checked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.auditing.findings import Finding, right, unknown, wrong
from benchmark.auditing.matches import WORKING_SIDE, Pair
from objconnect.scene.checks.conventions import FOREIGN_CONVENTIONS, PoseConvention
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.sampson import Matches

Array = NDArray[np.float64]

CHECK = "poses agree with the photographs"
# A match agrees if its Sampson error (px) is at most this in a photograph of the working size. The
# limit grows with the size, and is at least the second value.
_LIMIT_PX, _MIN_LIMIT_PX = 2.0, 1.0
# Poses are right if this share of the matches agrees with them.
RIGHT_SHARE = 0.7
# Another convention is reported if it raises the share of agreeing matches by more than this.
MIN_GAIN = 0.15
# With fewer pairs or matches, the check decides nothing.
_LEAST_PAIRS = 3
_LEAST_MATCHES = 150


@dataclass(frozen=True)
class Rays:
    """The matches of a pair of photographs as rays.

    Attributes:
        pair: the pair.
        first: rays (K, 3) with z = 1 in the first camera.
        second: rays (K, 3) in the second.
        focal: focal length of the second, pixels.
        threshold: largest error of a match that agrees, pixels.
    """

    pair: Pair
    first: torch.Tensor
    second: torch.Tensor
    focal: float
    threshold: float


def rays_of(pairs: Sequence[Pair], cameras: Sequence[Camera | None]) -> list[Rays]:
    """Return the matches of each pair as rays; a pair with an unknown camera is left out."""
    all_rays = []
    for pair in pairs:
        a, b = cameras[pair.first], cameras[pair.second]
        if a is None or b is None:
            continue
        first, valid = a.unproject(torch.from_numpy(pair.xy_first))
        second, valid_second = b.unproject(torch.from_numpy(pair.xy_second))
        is_valid = valid & valid_second
        scale = max(b.width, b.height) / WORKING_SIDE
        focal = float(np.mean(b.focal))
        threshold = max(_LIMIT_PX * scale, _MIN_LIMIT_PX)
        all_rays.append(Rays(pair, first[is_valid], second[is_valid], focal, threshold))
    return all_rays


def sampson_errors(rays: Rays, poses: Array) -> Array:
    """Return the Sampson error (px) of each match (K,).

    It is infinite for points behind a camera, and for two cameras at one position.

    Args:
        rays: matches of a pair.
        poses: cam_from_world (N, 4, 4) of all photographs.
    """
    first = Pose.from_matrix(poses[rays.pair.first])
    second = Pose.from_matrix(poses[rays.pair.second])
    relative = second @ first.inverse()
    if not bool(relative.translation.norm() > 0):
        return np.full(len(rays.first), np.inf)
    error, _ = Matches(first, rays.second, rays.first).residuals(second, rays.focal)
    # Distances along both rays, by least squares of a R x_1 + t = b x_2.
    rotated = rays.first @ relative.rotation.T
    t = relative.translation
    aa, bb = (rotated**2).sum(1), (rays.second**2).sum(1)
    ab, at, bt = (rotated * rays.second).sum(1), rotated @ t, rays.second @ t
    determinant = (aa * bb - ab**2).clamp_min(1e-18)
    along_first = (ab * bt - bb * at) / determinant
    along_second = (aa * bt - ab * at) / determinant
    behind = (along_first <= 0) | (along_second <= 0)
    return np.asarray(torch.where(behind, torch.inf, error.abs()).numpy())


def agreement_by_pair(rays: Sequence[Rays], poses: Array) -> Array:
    """Return for each pair the share of its matches that agree with the poses, (P,)."""
    return np.array([float((sampson_errors(r, poses) < r.threshold).mean()) for r in rays])


def mean_agreement(rays: Sequence[Rays], poses: Array) -> float:
    """Return the mean over all pairs of the share of agreeing matches."""
    return float(agreement_by_pair(rays, poses).mean())


def explain_too_few(rays: Sequence[Rays]) -> str:
    """Return why there are too few matches to decide anything; empty if there are enough."""
    matches = sum(len(r.first) for r in rays)
    if len(rays) < _LEAST_PAIRS or matches < _LEAST_MATCHES:
        return (
            f"{matches} matches between {len(rays)} pairs of photographs are too few: the "
            "photographs do not overlap, or cannot be read"
        )
    return ""


def best_convention(rays: Sequence[Rays], poses: Array) -> tuple[PoseConvention | None, float]:
    """Return the convention in which most matches agree with the poses, and their share.

    The convention is None if none raises the share of the stated poses by more than ``MIN_GAIN``.
    """
    as_stated = mean_agreement(rays, poses)
    candidates = [
        (mean_agreement(rays, convention.poses(poses)), convention)
        for convention in FOREIGN_CONVENTIONS
    ]
    best, convention = max(candidates, key=lambda item: item[0])
    return (convention, best) if best > as_stated + MIN_GAIN else (None, as_stated)


def check_poses(rays: Sequence[Rays], poses: Array) -> tuple[Finding, Array]:
    """Check poses, and return them in the convention that agrees with the photographs."""
    if why := explain_too_few(rays):
        return unknown(CHECK, why), poses
    as_stated = mean_agreement(rays, poses)
    figures = {"agreeing": as_stated, "pairs": float(len(rays))}
    convention, best = best_convention(rays, poses)
    if convention is not None and best >= RIGHT_SHARE:
        agree = f"{best:.0%} of the matches agree in this convention, {as_stated:.0%} as stated"
        finding = wrong(
            CHECK, convention.name, f"{convention.fault}: {agree}", **figures, explained=best
        )
        return finding, convention.poses(poses)
    if as_stated >= RIGHT_SHARE:
        pixels = float(np.median(np.concatenate([sampson_errors(r, poses) for r in rays])))
        matches = sum(len(r.first) for r in rays)
        detail = (
            f"{as_stated:.0%} of {matches} matches in {len(rays)} pairs, median {pixels:.2f} px"
        )
        return right(CHECK, detail, **figures, median_px=pixels), poses
    detail = f"{as_stated:.0%} of the matches agree, and no other convention explains them"
    return wrong(CHECK, "poses-inexact", detail, **figures), poses
