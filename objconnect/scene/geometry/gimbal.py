"""The attitude of a camera as the angles that a gimbal has."""

from __future__ import annotations

import numpy as np
import torch

from objconnect.scene.geometry.pose import Pose

# A camera whose axis leans less from the plumb line (rad) looks straight down.
_PLUMB = 1e-6


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
