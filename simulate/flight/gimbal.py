"""Compute poses of gimballed cameras from positions and viewing directions.

Poses are ``cam_from_world`` (N, 4, 4) float64: OpenCV axes (x right, y down, z forward), world
east-north-up in metres with Z up. Headings are clockwise from north, pitches are above the horizon.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.flight.context import Wind

Array = NDArray[np.float64]


class Aims(NamedTuple):
    """Planned exposures in flying order.

    Attributes:
        centres: Camera centres (N, 3), world metres.
        heading: Directions (N,) of the cameras, radians clockwise from north.
        pitch: Pitches (N,) of the cameras, radians above the horizon.
    """

    centres: Array
    heading: Array
    pitch: Array


def perturb_poses(aims: Aims, wind: Wind, rng: np.random.Generator) -> Array:
    """Return the poses ``cam_from_world`` (N, 4, 4) of planned exposures, perturbed by wind."""
    centres = aims.centres + wind.position_jitter_m * rng.standard_normal(aims.centres.shape)
    return gimbal_poses(centres, aims.heading, aims.pitch, wind.attitude_jitter_deg, rng)


def gimbal_poses(
    centres: Array,
    heading: Array,
    pitch: ArrayLike,
    jitter_deg: float,
    rng: np.random.Generator,
) -> Array:
    """Return the poses ``cam_from_world`` (N, 4, 4) of cameras that a gimbal holds level.

    Args:
        centres: Camera centres (N, 3), world metres.
        heading: Headings (N,), radians.
        pitch: Pitches (N,), or one pitch for all, radians.
        jitter_deg: Standard deviation of yaw, pitch and roll, degrees.
        rng: The generator of the jitter.
    """
    count = len(centres)
    jitter = np.radians(jitter_deg) * rng.standard_normal((count, 3))
    yaw = heading + jitter[:, 0]
    tilt = np.broadcast_to(pitch, count) + jitter[:, 1]
    roll = jitter[:, 2]
    zero = np.zeros(count)
    ahead = np.stack([np.sin(yaw), np.cos(yaw), zero], -1)
    right = np.stack([np.cos(yaw), -np.sin(yaw), zero], -1)
    up = np.array([0.0, 0.0, 1.0])
    forward = np.cos(tilt)[:, None] * ahead + np.sin(tilt)[:, None] * up
    down = np.sin(tilt)[:, None] * ahead - np.cos(tilt)[:, None] * up
    x = np.cos(roll)[:, None] * right + np.sin(roll)[:, None] * down
    y = np.cos(roll)[:, None] * down - np.sin(roll)[:, None] * right
    pose = np.tile(np.eye(4), (count, 1, 1))
    pose[:, :3, :3] = np.stack([x, y, forward], axis=1)
    pose[:, :3, 3] = -np.einsum("nij,nj->ni", pose[:, :3, :3], centres)
    return pose


def velocities(cam_from_world: ArrayLike, interval_s: float) -> Array:
    """Return velocities (N, 3) in metres per second of poses (N, 4, 4) taken at equal intervals.

    Velocities are central differences of the positions, one-sided at both ends, and zero for a
    single pose.
    """
    centres = camera_centres(cam_from_world)
    if len(centres) < 2:
        return np.zeros_like(centres)
    return np.asarray(np.gradient(centres, interval_s, axis=0))


def camera_centres(cam_from_world: ArrayLike) -> Array:
    """Return the camera centres (N, 3) in world metres of poses ``cam_from_world`` (N, 4, 4)."""
    pose = np.asarray(cam_from_world, float)
    return np.asarray(-np.einsum("nji,nj->ni", pose[:, :3, :3], pose[:, :3, 3]))
