"""A hilly ground whose features are known everywhere, so that the true pose is the best one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.align.residuals import Level
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose, so3_exp

PINHOLE: Final = Camera("PINHOLE", 320, 256, (260.0, 255.0, 158.0, 130.0))
DISTORTED: Final = Camera(
    "OPENCV", 320, 256, (260.0, 255.0, 158.0, 130.0, -0.06, 0.01, 1e-3, -5e-4)
)
# Of each scale.
CHANNELS: Final = (24, 24, 12)


def looking_down(seed: int = 0) -> Pose:
    """A camera at 80 m, nadir but for some degrees."""
    rng = np.random.default_rng(seed)
    nadir = torch.tensor([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]], dtype=torch.float64)
    rotation = so3_exp(torch.as_tensor(rng.normal(0, 0.06, 3))) @ nadir
    centre = torch.as_tensor(np.array([*rng.uniform(-30, 30, 2), 80.0]))
    return Pose(rotation, -(rotation @ centre))


def wrong(pose: Pose, metres: float, degrees: float, seed: int) -> Pose:
    """The pose of a camera that far off in position and in attitude, in random directions."""
    rng = np.random.default_rng(seed)
    axis, shift = (torch.as_tensor(v / np.linalg.norm(v)) for v in rng.normal(size=(2, 3)))
    rotation = so3_exp(np.deg2rad(degrees) * axis) @ pose.rotation
    return Pose(rotation, -(rotation @ (pose.centre() + metres * shift)))


@dataclass(frozen=True)
class World:
    """Ground and features made of waves.

    Attributes:
        seed: of everything random.
        shortest: wavelength (m) of the features of each scale, as seen from 80 m.
        longest: over the shortest. Short waves alone guide no further than half of one.
        strides: of the scales.
    """

    seed: int = 0
    shortest: tuple[float, ...] = (25.0, 8.0, 3.0)
    longest: float = 4.0
    strides: tuple[int, ...] = (16, 4, 1)

    def height(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Metres above zero at (..., 2)."""
        rng = np.random.default_rng([self.seed, 99])
        waves = rng.normal(size=(6, 2)) / rng.uniform(8, 20, (6, 1))
        phase = rng.uniform(0, 2 * np.pi, 6)
        return 1.5 * np.sin(xy @ waves.T + phase).sum(-1)

    def features(self, xy: NDArray[np.float64], scale: int) -> NDArray[np.float64]:
        """Unit features (..., C) of one scale at places (..., 2)."""
        rng = np.random.default_rng([self.seed, scale])
        count = 48
        length = self.shortest[scale] * rng.uniform(1, self.longest, count)
        angle = rng.uniform(0, 2 * np.pi, count)
        waves = np.stack([np.cos(angle), np.sin(angle)], -1) * (2 * np.pi / length)[:, None]
        field = np.cos(xy @ waves.T + rng.uniform(0, 2 * np.pi, count))
        mixed = field @ rng.normal(size=(count, CHANNELS[scale]))
        return mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)

    def points(self, camera: Camera, pose: Pose, count: int) -> NDArray[np.float64]:
        """Points of the ground a camera sees, (count, 3)."""
        rng = np.random.default_rng([self.seed, 7])
        pixels = rng.uniform((4, 4), (camera.width - 4, camera.height - 4), (count, 2))
        return self.ground(camera, pose, pixels)

    def ground(
        self, camera: Camera, pose: Pose, pixels: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Where rays through pixels (n, 2) meet the ground, (n, 3)."""
        rays = camera.unproject(torch.as_tensor(pixels))[0].numpy() @ pose.rotation.numpy()
        centre = pose.centre().numpy()
        height = np.zeros(len(rays))
        for _ in range(25):
            ground = centre + rays * ((height - centre[2]) / rays[:, 2])[:, None]
            height = self.height(ground[:, :2])
        return np.concatenate([ground[:, :2], height[:, None]], -1)

    def picture(self, camera: Camera, pose: Pose, scale: int) -> NDArray[np.float32]:
        """Features (C, h, w) of the whole picture at one scale."""
        s = self.strides[scale]
        w, h = camera.width // s, camera.height // s
        x, y = np.meshgrid((np.arange(w) + 0.5) * s, (np.arange(h) + 0.5) * s)
        ground = self.ground(camera, pose, np.stack([x, y], -1).reshape(-1, 2))
        maps = self.features(ground[:, :2], scale).reshape(h, w, -1)
        return maps.transpose(2, 0, 1).astype(np.float32)

    def trust(self, camera: Camera, scale: int) -> NDArray[np.float32]:
        """Confidence (1, h, w) that varies smoothly over the picture."""
        s = self.strides[scale]
        w, h = camera.width // s, camera.height // s
        x, y = np.meshgrid(np.arange(w) / w, np.arange(h) / h)
        return (0.55 + 0.4 * np.sin(5 * x + 3 * y + scale))[None].astype(np.float32)

    def levels(
        self,
        camera: Camera,
        pose: Pose,
        points: NDArray[np.float64],
        *,
        confident: bool = False,
        noise: float = 0.0,
        seed: int = 0,
    ) -> list[Level]:
        """Levels of one query (B = 1), coarse to fine, and the features of its points."""
        rng = np.random.default_rng([self.seed, seed, 3])
        levels = []
        for scale, stride in enumerate(self.strides):
            maps = torch.as_tensor(self.picture(camera, pose, scale))[None]
            reference = self.features(points[:, :2], scale)
            reference = reference + rng.normal(0, noise, reference.shape)
            levels.append(
                Level(
                    features=maps.contiguous(memory_format=torch.channels_last),
                    stride=stride,
                    reference=tensor(reference),
                    confidence=tensor(self.trust(camera, scale)) if confident else None,
                    reference_confidence=(
                        tensor(rng.uniform(0.3, 1, len(points))) if confident else None
                    ),
                )
            )
        return levels


def tensor(values: NDArray[np.generic] | Sequence[float]) -> Tensor:
    """Single precision, with a batch of one in front."""
    return torch.as_tensor(np.asarray(values, dtype=np.float32))[None]
