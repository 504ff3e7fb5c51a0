"""A map of smooth ground, photographed from 20 m by formula: truth without a renderer."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from objconnect.learning.checkpoint import write_weights
from objconnect.learning.pixloc_net import PixlocNet, PixlocNetConfig
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.sparse_map import MapImage, SparseMap

CAMERA = Camera("PINHOLE", 256, 192, (220.0, 224.0, 126.0, 98.0))
HEIGHT = 20.0


def looking_down(x: float, y: float, turn: tuple[float, float, float] = (0, 0, 0)) -> Pose:
    """Above a place, turned (degrees) from straight down."""
    down = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    turned = Pose.exp(torch.deg2rad(torch.tensor([*turn, 0, 0, 0], dtype=torch.float64)))
    rotation = turned.rotation @ down
    return Pose(rotation, -rotation @ torch.tensor([x, y, HEIGHT], dtype=torch.float64))


def height(x: Tensor, y: Tensor) -> Tensor:
    """Of the ground, metres."""
    return 1.5 * torch.sin(0.35 * x) * torch.cos(0.3 * y)


def photograph(pose: Pose, camera: Camera = CAMERA) -> NDArray[np.uint8]:
    """(H, W, 3) of the ground."""
    rays, _ = camera.unproject(camera.pixel_grid().flatten(0, 1))
    rays = rays @ pose.rotation
    centre = pose.centre()
    ground = centre - rays * (centre[2] / rays[:, 2:])
    for _ in range(20):  # the relief is gentle: where a ray meets it is a fixed point
        above = height(ground[:, 0], ground[:, 1]) - centre[2]
        ground = centre + rays * (above / rays[:, 2])[:, None]
    x, y = ground[:, 0].numpy(), ground[:, 1].numpy()
    waves = [
        np.sin(1.3 * x + c) * np.cos((1.1 + 0.2 * c) * y)
        + np.sin(0.6 * x - 0.9 * y + c)
        + np.cos(0.05 * (x + c) * y)
        for c in range(3)
    ]
    shades = np.stack(waves, -1).reshape(camera.height, camera.width, 3) / 6 + 0.5
    return np.asarray((255 * shades).astype(np.uint8))


@cache
def _photographs(camera: Camera) -> list[tuple[Pose, Image.Image]]:
    """Five photographs 6 m apart and their poses, computed once in a process."""
    poses = [looking_down(6.0 * number, 0.5 * (number % 2)) for number in range(5)]
    return [(pose, Image.fromarray(photograph(pose, camera))) for pose in poses]


def write_map(images: Path, camera: Camera = CAMERA) -> SparseMap:
    """Five photographs 6 m apart, and the points of a grid that they see."""
    x, y = np.meshgrid(np.arange(-12, 37, 0.8), np.arange(-10, 11, 0.8))
    x, y = torch.from_numpy(x).flatten(), torch.from_numpy(y).flatten()
    xyz = torch.stack([x, y, height(x, y)], -1).numpy()
    posed, tracks = {}, np.zeros(len(xyz), np.int64)
    images.mkdir()
    for number, (pose, picture) in enumerate(_photographs(camera)):
        name = f"{number}.png"
        picture.save(images / name)
        projected = camera.project(pose.transform(torch.from_numpy(xyz)))
        rows = np.flatnonzero((projected.valid & camera.contains(projected.xy)).numpy())
        tracks[rows] += 1
        posed[name] = MapImage(
            name, camera, pose.matrix().numpy(), projected.xy.numpy()[rows], rows.astype(np.int64)
        )
    return SparseMap(posed, xyz, np.zeros((len(xyz), 3), np.uint8), np.zeros(len(xyz)), tracks)


def write_network(path: Path) -> Path:
    """A slim network without training: its features are those of random filters."""
    torch.manual_seed(0)
    config = PixlocNetConfig(width=0.25, decoder=(32, 32, 32, 16), dims=(64, 32, 16))
    write_weights(path, PixlocNet(config), config.model_dump())
    return path
