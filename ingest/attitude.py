"""Attitudes that a gimbal wrote into photographs, and photographs that were rotated afterwards."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from ingest.georegister import Georegistration
from ingest.options import IngestOptions
from ingest.photographs import FlightImage
from scene.geometry.pose import Pose
from scene.maps.sparse_map import SparseMap

# A camera whose axis leans less from the plumb line (rad) looks straight down.
_PLUMB = 1e-6
_OVER = np.diag([-1.0, -1.0, 1.0])


def gimbal_pose(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Pose:
    """Return the rotation ``cam_from_world`` of a gimbal, as a pose at the origin.

    Args:
        yaw_deg: Yaw of the optical axis, clockwise from north.
        pitch_deg: Pitch of the optical axis above the horizon.
        roll_deg: Roll about the optical axis, clockwise as the camera looks.
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


def gimbal_angles(pose: Pose) -> tuple[float, float, float]:
    """Return yaw, pitch and roll in degrees of a camera's attitude, the inverse of ``gimbal_pose``.

    A camera that looks straight down or up has no yaw of its own: its roll is taken to be 0.
    """
    right, _, forward = pose.rotation.numpy()
    level = float(np.hypot(forward[0], forward[1]))
    pitch = float(np.arctan2(forward[2], level))
    if level < _PLUMB:
        return float(np.degrees(np.arctan2(-right[1], right[0]))), float(np.degrees(pitch)), 0.0
    yaw = float(np.arctan2(forward[0], forward[1]))
    level_right = np.array([np.cos(yaw), -np.sin(yaw), 0.0])
    level_down = np.cross(forward, level_right)
    roll = float(np.arctan2(right @ level_down, right @ level_right))
    return float(np.degrees(yaw)), float(np.degrees(pitch)), float(np.degrees(roll))


def turned_over(
    model: SparseMap,
    placed: Georegistration,
    images: Sequence[FlightImage],
    max_error_deg: float,
) -> set[str]:
    """Return the names of photographs that someone has rotated by 180 degrees.

    Their gimbals contradict them by 180 degrees, while the gimbals of more of the other photographs
    agree. Such a photograph has the same lens as the others, but its principal point lies on the
    other side of the image.

    Args:
        model: The model, in a frame of its own.
        placed: Where the model is in the world.
        images: Photographs of the model; there may be others.
        max_error_deg: A photograph that is further off contradicts its gimbal.
    """
    linear = placed.world_from_model[:, :3]
    turn = linear / np.cbrt(np.linalg.det(linear))
    over, upright = set(), 0
    for image in images:
        if image.exif.gimbal is None or image.name not in model.images:
            continue
        seen = model.images[image.name].cam_from_world[:3, :3] @ turn.T
        upright += _degrees(image, seen) < max_error_deg
        if _degrees(image, _OVER @ seen) < max_error_deg:
            over.add(image.name)
    return over if len(over) < upright else set()


def _degrees(image: FlightImage, cam_from_world: NDArray[np.float64]) -> float:
    """Return the angle between the gimbal and a rotation (3, 3) of the camera."""
    assert image.exif.gimbal is not None
    said = gimbal_pose(*image.exif.gimbal)
    return float(said.error_to(Pose(torch.tensor(cam_from_world), said.translation))[1])


def attitudes(
    images: Sequence[FlightImage],
    poses: NDArray[np.float64],
    queries: set[str],
    options: IngestOptions,
) -> tuple[NDArray[np.float64], NDArray[np.float64], dict[str, float]]:
    """Return the attitudes of the gimbal, how exact they are, and those that are wrong.

    Args:
        images: The photographs.
        poses: Poses ``cam_from_world`` (N, 4, 4) of the photographs.
        queries: Names of the queries. The sigma is measured on the other photographs.
        options: Which attitudes are wrong, and the least sigma.

    Returns:
        Quaternions (N, 4), w x y z, and their sigma (N,) in degrees per axis, both NaN for a
        photograph without a usable attitude; and by file the error in degrees of each attitude
        that contradicts its photograph.
    """
    quaternions = np.full((len(images), 4), np.nan)
    errors = np.full(len(images), np.nan)
    for k, image in enumerate(images):
        if image.exif.gimbal is not None:
            quaternions[k] = gimbal_pose(*image.exif.gimbal).quaternion().numpy()
            errors[k] = _degrees(image, poses[k, :3, :3])
    wrong = errors > options.max_attitude_error_deg
    blunders = {images[k].file: float(errors[k]) for k in np.flatnonzero(wrong)}
    quaternions[wrong] = errors[wrong] = np.nan
    known = np.isfinite(errors)
    mapped = known & np.array([image.name not in queries for image in images])
    if not mapped.any():
        mapped = known
    sigma = np.sqrt((errors[mapped] ** 2).mean() / 3) if known.any() else np.nan
    sigma = np.maximum(sigma, options.min_attitude_sigma_deg)
    return quaternions, np.where(known, sigma, np.nan), blunders
