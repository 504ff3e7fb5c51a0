"""From where a camera is and where it looks to its pose, with the wind's share.

Poses are `cam_from_world` (N, 4, 4) float64: OpenCV axes (x right, y down, z forward), world
east-north-up metres with Z up. Headings are clockwise from north, pitches above the horizon.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class Aims(NamedTuple):
    """Exposures as planned, in flying order.

    Attributes:
        centres: of the cameras, (N, 3) world metres.
        heading: (N,) radians clockwise from north.
        pitch: (N,) radians above the horizon.
    """

    centres: Array
    heading: Array
    pitch: Array


def perturbed_poses(
    aims: Aims, position_jitter_m: float, attitude_jitter_deg: float, rng: np.random.Generator
) -> Array:
    """Poses (N, 4, 4) of aims blown about, by standard deviations per axis."""
    blown = aims.centres + position_jitter_m * rng.standard_normal(aims.centres.shape)
    return gimbal_poses(blown, aims.heading, aims.pitch, attitude_jitter_deg, rng)


def gimbal_poses(
    centres: Array,
    heading: Array,
    pitch: ArrayLike,
    jitter_deg: float,
    rng: np.random.Generator,
) -> Array:
    """Poses (N, 4, 4) of level cameras at `centres` (N, 3) metres.

    Args:
        heading: (N,) radians. pitch: (N,) or one for all, radians.
        jitter_deg: standard deviation of yaw, pitch and roll.
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
    """Velocities (N, 3), metres a second, of cameras with poses (N, 4, 4) at equal intervals:
    central differences of their positions, one-sided at the ends, zero for a single one."""
    centres = camera_centres(cam_from_world)
    if len(centres) < 2:
        return np.zeros_like(centres)
    return np.asarray(np.gradient(centres, interval_s, axis=0))


def camera_centres(cam_from_world: ArrayLike) -> Array:
    """World positions (N, 3) metres of cameras with poses (N, 4, 4)."""
    pose = np.asarray(cam_from_world, float)
    return np.asarray(-np.einsum("nji,nj->ni", pose[:, :3, :3], pose[:, :3, 3]))
