"""What a gimbal says about photographs, and photographs that were turned over since."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from ingest.georegister import Georegistration
from ingest.photographs import Shot
from scene.geometry.pose import Pose
from scene.maps.sparse_map import SparseMap

# A gimbal is off by a few degrees, its compass by more; a picture turned over by the camera is not
# what its gimbal says.
_WRONG_DEG = 30.0
_LEAST_SIGMA_DEG = 0.1
_OVER = np.diag([-1.0, -1.0, 1.0])


def gimbal_pose(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Pose:
    """The rotation ``cam_from_world`` of a gimbal, at the origin.

    Args:
        yaw_deg: of the optical axis, clockwise from north.
        pitch_deg: of it above the horizon.
        roll_deg: about it, clockwise as the camera looks.
    """
    yaw, pitch, roll = np.radians([yaw_deg, pitch_deg, roll_deg])
    forward = [np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)]
    right = np.array([np.cos(yaw), -np.sin(yaw), 0.0])
    down = np.cross(forward, right)
    rolled = [
        np.cos(roll) * right + np.sin(roll) * down,
        np.cos(roll) * down - np.sin(roll) * right,
        forward,
    ]
    return Pose(torch.tensor(np.array(rolled)), torch.zeros(3, dtype=torch.float64))


def turned_over(model: SparseMap, placed: Georegistration, shots: Sequence[Shot]) -> set[str]:
    """Photographs that someone has turned by 180° since: their gimbal says so, and the others'
    gimbals, which are more, agree with theirs.

    Their lens is no other one, but its principal point lies on the other side of the picture.

    Args:
        model: in a frame of its own.
        placed: where that is.
        shots: photographs of the model, and others.
    """
    linear = placed.world_from_model[:, :3]
    turn = linear / np.cbrt(np.linalg.det(linear))
    over, upright = set(), 0
    for shot in shots:
        if shot.exif.gimbal is None or shot.name not in model.images:
            continue
        seen = model.images[shot.name].cam_from_world[:3, :3] @ turn.T
        upright += _degrees(shot, seen) < _WRONG_DEG
        if _degrees(shot, _OVER @ seen) < _WRONG_DEG:
            over.add(shot.name)
    return over if len(over) < upright else set()


def _degrees(shot: Shot, cam_from_world: NDArray[np.float64]) -> float:
    """Between the gimbal and a rotation (3, 3) of the camera."""
    assert shot.exif.gimbal is not None
    said = gimbal_pose(*shot.exif.gimbal)
    return float(said.error_to(Pose(torch.tensor(cam_from_world), said.translation))[1])


def attitudes(
    shots: Sequence[Shot], poses: NDArray[np.float64], queries: set[str]
) -> tuple[NDArray[np.float64], NDArray[np.float64], dict[str, float]]:
    """Quaternions (N, 4) of the gimbal and their sigma (N,), degrees per axis, NaN without one; and
    by file how far (degrees) those are off that contradict their photograph.

    Args:
        shots: photographs.
        poses: (N, 4, 4) ``cam_from_world``.
        queries: names; the sigma is that of the others.
    """
    quaternions = np.full((len(shots), 4), np.nan)
    errors = np.full(len(shots), np.nan)
    for k, shot in enumerate(shots):
        if shot.exif.gimbal is not None:
            quaternions[k] = gimbal_pose(*shot.exif.gimbal).quaternion().numpy()
            errors[k] = _degrees(shot, poses[k, :3, :3])
    wrong = errors > _WRONG_DEG
    blunders = {shots[k].file: float(errors[k]) for k in np.flatnonzero(wrong)}
    quaternions[wrong] = errors[wrong] = np.nan
    known = np.isfinite(errors)
    mapped = known & np.array([shot.name not in queries for shot in shots])
    if not mapped.any():
        mapped = known
    sigma = np.sqrt((errors[mapped] ** 2).mean() / 3) if known.any() else np.nan
    return quaternions, np.where(known, np.maximum(sigma, _LEAST_SIGMA_DEG), np.nan), blunders
