"""Conversion between a camera's attitude and the yaw, pitch and roll of a gimbal."""

from __future__ import annotations

import numpy as np
import torch

from objconnect.scene.geometry.pose import Pose

# Tilt (rad) below which a camera looks straight down or up.
_MAX_PLUMB_TILT = 1e-6


def gimbal_pose(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Pose:
    """Return the rotation ``cam_from_world`` of a gimbal, as a pose at the origin.

    Args:
        yaw_deg: yaw of the optical axis, clockwise from north.
        pitch_deg: pitch of the optical axis above the horizon.
        roll_deg: roll about the optical axis, clockwise in viewing direction.
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
    """Return yaw, pitch and roll (degrees) of a camera, the inverse of ``gimbal_pose``.

    For a camera that looks straight down or up, yaw is ambiguous and roll is set to 0.
    """
    right, _, forward = pose.rotation.numpy()
    level = float(np.hypot(forward[0], forward[1]))
    pitch = float(np.arctan2(forward[2], level))
    if level < _MAX_PLUMB_TILT:
        return float(np.degrees(np.arctan2(-right[1], right[0]))), float(np.degrees(pitch)), 0.0
    yaw = float(np.arctan2(forward[0], forward[1]))
    level_right = np.array([np.cos(yaw), -np.sin(yaw), 0.0])
    level_down = np.cross(forward, level_right)
    roll = float(np.arctan2(right @ level_down, right @ level_right))
    return float(np.degrees(yaw)), float(np.degrees(pitch)), float(np.degrees(roll))
