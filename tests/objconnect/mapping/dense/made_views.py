"""Photographs of one slanted, textured plane, exact at every pixel."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from objconnect.mapping.dense.warp import StereoView
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import so3_exp

CAMERA = Camera("PINHOLE", 96, 80, (90.0, 92.0, 47.0, 41.0))
# World points on the plane: (normal, x) = 1.
PLANE = torch.tensor([0.006, -0.004, 0.024], dtype=torch.float64)


def pose_at(x: float, y: float, tilt: float = 0.0) -> np.ndarray:
    """A camera near the origin that looks along z."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = so3_exp(torch.tensor([0.0, tilt, 0.3 * tilt], dtype=torch.float64))
    pose[:3, 3] = -pose[:3, :3] @ torch.tensor([x, y, 0.0], dtype=torch.float64)
    return pose.numpy()


def inverse_depth_at(view: StereoView) -> Tensor:
    """(H, W) float64, the truth."""
    pose = torch.from_numpy(view.cam_from_world)
    rays, _ = view.camera.unproject(view.camera.pixel_grid())
    directions = rays @ pose[:3, :3]
    centre = -pose[:3, :3].T @ pose[:3, 3]
    return (directions @ PLANE) / (1 - centre @ PLANE)


def photograph(x: float, y: float, tilt: float = 0.0) -> StereoView:
    """What a camera at x, y (m) sees of the plane, some 40 m away."""
    view = StereoView(torch.zeros(CAMERA.height, CAMERA.width), CAMERA, pose_at(x, y, tilt))
    pose = torch.from_numpy(view.cam_from_world)
    rays, _ = CAMERA.unproject(CAMERA.pixel_grid())
    local = rays / inverse_depth_at(view)[..., None]
    world = (local - pose[:3, 3]) @ pose[:3, :3]
    return StereoView(_texture(world).float(), CAMERA, view.cam_from_world)


# A square on a pole, facing the cameras: its middle, and half its side (m).
_MIDDLE, _HALF = torch.tensor([2.0, -3.0, 34.0], dtype=torch.float64), 0.45


def thing_in(view: StereoView) -> tuple[Tensor, Tensor]:
    """Inverse depth (H, W) of the plane with the square before it, and where the square is."""
    pose = torch.from_numpy(view.cam_from_world)
    rays, _ = view.camera.unproject(view.camera.pixel_grid())
    directions = rays @ pose[:3, :3]
    centre = -pose[:3, :3].T @ pose[:3, 3]
    inverse = directions[..., 2] / (_MIDDLE[2] - centre[2])
    met = centre + directions / inverse[..., None]
    inside = ((met - _MIDDLE).abs()[..., :2] < _HALF).all(-1)
    return torch.where(inside, inverse, inverse_depth_at(view)), inside


def with_thing(view: StereoView, camera: Camera) -> StereoView:
    """What another camera at the same place sees of the plane and of the square."""
    blank = StereoView(torch.zeros(camera.height, camera.width), camera, view.cam_from_world)
    inverse, inside = thing_in(blank)
    pose = torch.from_numpy(view.cam_from_world)
    rays, _ = camera.unproject(camera.pixel_grid())
    world = (rays / inverse[..., None] - pose[:3, 3]) @ pose[:3, :3]
    grey = torch.where(inside, 0.9 + _texture(world) / 2, _texture(world))
    return StereoView(grey.float(), camera, view.cam_from_world)


def _texture(world: Tensor) -> Tensor:
    """Waves in many directions, the shortest some five pixels long."""
    rng = np.random.default_rng(5)
    grey = torch.full(world.shape[:-1], 0.5, dtype=torch.float64)
    for _ in range(24):
        direction = rng.normal(size=3) / rng.uniform(0.5, 3.0)
        grey += 0.04 * torch.sin(world @ torch.from_numpy(direction) + rng.uniform(0, 6))
    return grey


REFERENCE = photograph(0, 0)
SOURCES = [photograph(7, 1, 0.05), photograph(-6, 2), photograph(1, 7, -0.04), photograph(0, -6)]
