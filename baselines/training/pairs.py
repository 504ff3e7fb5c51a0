"""Two images of the same ground with what is known of them: what every method here learns from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from baselines.training.options import PAIRS, PairOptions
from scene.geometry.pose import Pose, so3_exp
from scene.geometry.projection import Intrinsics


class Pinhole(NamedTuple):
    """A camera without distortion: focal lengths and principal point, (2,) pixels each."""

    focal: NDArray[np.float64]
    principal: NDArray[np.float64]

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of the camera frame (N, 3) -> pixels (N, 2). They must lie in front."""
        return np.asarray(points[:, :2] / points[:, 2:] * self.focal + self.principal)

    def lift(self, xy: NDArray[np.float64], depth: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels (N, 2) at depths (N,) -> points of the camera frame (N, 3)."""
        rays = (xy - self.principal) / self.focal
        return np.asarray(np.insert(rays, 2, 1.0, axis=1) * depth[:, None])


class Pair(NamedTuple):
    """One pair, in numpy: a is the reference, b the query.

    Attributes:
        image_a: (S, S, 3) uint8 RGB.
        image_b: likewise.
        camera_a: of image_a.
        camera_b: of image_b.
        b_from_a: (4, 4) rigid transform of the camera frames, metres.
        start: (4, 4) a wrong ``b_from_a`` to begin an alignment at.
        points: (N, 3) seen in both, in the frame of camera a.
        xy_a: (N, 2) where camera a sees them, pixels.
        xy_b: (N, 2) where camera b does.
        valid: (N,) false where N has more places than there are points.
    """

    image_a: NDArray[np.uint8]
    image_b: NDArray[np.uint8]
    camera_a: Pinhole
    camera_b: Pinhole
    b_from_a: NDArray[np.float64]
    start: NDArray[np.float64]
    points: NDArray[np.float64]
    xy_a: NDArray[np.float64]
    xy_b: NDArray[np.float64]
    valid: NDArray[np.bool_]


class PairSource(Protocol):
    """Draws pairs. The same generator state draws the same pair."""

    def draw(self, rng: np.random.Generator) -> Pair:
        """One pair."""
        ...


class PairBatch(NamedTuple):
    """B pairs as tensors; single precision but for the poses' home, see ``Pair``.

    Attributes:
        image_a: (B, 3, S, S) float32, RGB in 0..1.
        image_b: likewise.
        intrinsics_a: of batch shape (B,).
        intrinsics_b: likewise.
        b_from_a: of batch shape (B,), float32.
        start: likewise.
        points: (B, N, 3).
        xy_a: (B, N, 2).
        xy_b: (B, N, 2).
        valid: (B, N) bool.
    """

    image_a: Tensor
    image_b: Tensor
    intrinsics_a: Intrinsics
    intrinsics_b: Intrinsics
    b_from_a: Pose
    start: Pose
    points: Tensor
    xy_a: Tensor
    xy_b: Tensor
    valid: Tensor

    def to(self, device: torch.device) -> PairBatch:
        """The same batch on another device."""

        def lens(k: Intrinsics) -> Intrinsics:
            moved = (x.to(device) for x in (k.focal, k.principal, k.distortion, k.limit))
            return Intrinsics(k.fisheye, *moved)

        return PairBatch(
            self.image_a.to(device),
            self.image_b.to(device),
            lens(self.intrinsics_a),
            lens(self.intrinsics_b),
            self.b_from_a.to(device=device),
            self.start.to(device=device),
            *(x.to(device) for x in self[6:]),
        )


def collate(pairs: Sequence[Pair]) -> PairBatch:
    """Pairs of equal size and number of points as one batch."""

    def single(values: Sequence[NDArray[np.float64]]) -> Tensor:
        return torch.from_numpy(np.stack(values).astype(np.float32))

    def images(values: Sequence[NDArray[np.uint8]]) -> Tensor:
        stacked = torch.from_numpy(np.stack(values)).permute(0, 3, 1, 2)
        return stacked.float().div_(255)

    def intrinsics(cameras: Sequence[Pinhole]) -> Intrinsics:
        size = len(cameras)
        return Intrinsics(
            fisheye=False,
            focal=single([c.focal for c in cameras]),
            principal=single([c.principal for c in cameras]),
            distortion=torch.zeros(size, 4),
            limit=torch.full((size,), torch.inf),
        )

    return PairBatch(
        images([p.image_a for p in pairs]),
        images([p.image_b for p in pairs]),
        intrinsics([p.camera_a for p in pairs]),
        intrinsics([p.camera_b for p in pairs]),
        Pose.from_matrix(single([p.b_from_a for p in pairs])),
        Pose.from_matrix(single([p.start for p in pairs])),
        single([p.points for p in pairs]),
        single([p.xy_a for p in pairs]),
        single([p.xy_b for p in pairs]),
        torch.from_numpy(np.stack([p.valid for p in pairs])),
    )


def wrong_start(
    b_from_a: NDArray[np.float64],
    depth: float,
    rng: np.random.Generator,
    options: PairOptions = PAIRS,
) -> NDArray[np.float64]:
    """A pose near the truth, (4, 4): camera b turned and moved, ``depth`` metres from the ground.

    Turns reach ``options.start_deg`` and moves ``options.start_share`` of the depth; both lengths
    are uniform, so that small errors are as frequent as large ones.
    """
    turn = _direction(rng) * np.radians(options.start_deg) * rng.uniform()
    move = _direction(rng) * options.start_share * depth * rng.uniform()
    start = np.eye(4)
    start[:3, :3] = so3_exp(torch.from_numpy(turn)).numpy()
    start[:3, 3] = move
    return start @ b_from_a


def fill(
    size: int, points: NDArray[np.float64], *others: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], list[NDArray[np.float64]]]:
    """Arrays of at most ``size`` rows made exactly that long by repeating their first row.

    Returns:
        which rows are real, (size,), and the arrays.
    """
    count = min(len(points), size)
    rows = np.concatenate([np.arange(count), np.zeros(size - count, np.int64)])
    return np.arange(size) < count, [array[rows] for array in (points, *others)]


def _direction(rng: np.random.Generator) -> NDArray[np.float64]:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)
