"""Training pairs: two images of the same ground with their cameras, poses and common points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.learning.training.objects import ImageObjects, PairObjects
from objconnect.scene.geometry.pose import Pose, so3_exp
from objconnect.scene.geometry.projection import Intrinsics

MIN_POINTS: Final = 64
"""Least number of points of a pair; with fewer, another pair is drawn."""

BORDER_PX: Final = 4.0
"""Least distance of points from the edge of an image, because features there depend on padding."""

# Largest error of an initial transform: rotation, and translation as a share of the depth. Poses
# from the sensors of an aircraft have errors of about this size.
_START_DEG: Final = 10.0
_START_SHARE: Final = 0.08


class Pinhole(NamedTuple):
    """A camera without distortion: focal lengths and principal point, (2,) pixels each."""

    focal: NDArray[np.float64]
    principal: NDArray[np.float64]

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Project points (N, 3) of the camera frame, in front of it, to pixels (N, 2)."""
        return np.asarray(points[:, :2] / points[:, 2:] * self.focal + self.principal)

    def lift(self, xy: NDArray[np.float64], depth: NDArray[np.float64]) -> NDArray[np.float64]:
        """Lift pixels (N, 2) at depths (N,) to points (N, 3) of the camera frame."""
        rays = (xy - self.principal) / self.focal
        return np.asarray(np.insert(rays, 2, 1.0, axis=1) * depth[:, None])


class Pair(NamedTuple):
    """A pair of images in numpy. Image a is the reference and image b the query.

    Attributes:
        image_a: reference image (S, S, 3) uint8 RGB.
        image_b: query image (S, S, 3) uint8 RGB.
        camera_a: camera of image a.
        camera_b: camera of image b.
        b_from_a: rigid transform (4, 4) between the camera frames, metres.
        start: ``b_from_a`` (4, 4) with an error, from which an alignment starts.
        points: points (N, 3) that both images show, in the frame of camera a, metres.
        xy_a: projections (N, 2) of the points in image a, pixels.
        xy_b: projections (N, 2) of the points in image b, pixels.
        valid: (N,) bool; false for padding.
        objects: the objects of image a and of image b; None if unknown.
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
    objects: tuple[PairObjects, PairObjects] | None = None


class PairSource(Protocol):
    """A source of pairs. Equal states of the generator give equal pairs."""

    def draw(self, rng: np.random.Generator) -> Pair:
        """Draw a pair."""
        ...


class PairBatch(NamedTuple):
    """B pairs as tensors in single precision. ``Pair`` describes the other fields.

    Attributes:
        image_a: reference images (B, 3, S, S) float32, RGB in 0..1.
        image_b: query images (B, 3, S, S).
        intrinsics_a: intrinsics of the reference cameras, batch shape (B,).
        intrinsics_b: intrinsics of the query cameras, batch shape (B,).
        b_from_a: transforms of batch shape (B,), float32.
        start: transforms with errors, of batch shape (B,), float32.
        objects: the objects of the images a, then of the images b; empty if unknown.
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
    objects: tuple[ImageObjects, ...] = ()

    def to(self, device: torch.device) -> PairBatch:
        """Return the batch on another device."""

        def move(k: Intrinsics) -> Intrinsics:
            moved = (x.to(device) for x in (k.focal, k.principal, k.distortion, k.limit))
            return Intrinsics(k.fisheye, *moved)

        return PairBatch(
            self.image_a.to(device),
            self.image_b.to(device),
            move(self.intrinsics_a),
            move(self.intrinsics_b),
            self.b_from_a.to(device=device),
            self.start.to(device=device),
            self.points.to(device),
            self.xy_a.to(device),
            self.xy_b.to(device),
            self.valid.to(device),
            tuple(each.to(device) for each in self.objects),
        )


def collate(pairs: Sequence[Pair]) -> PairBatch:
    """Collate pairs of equal size and number of points into a batch."""

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

    known = [p.objects for p in pairs if p.objects is not None]
    objects = [a for a, _ in known] + [b for _, b in known] if len(known) == len(pairs) else []
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
        tuple(ImageObjects.of(each) for each in objects),
    )


def perturb_transform(
    b_from_a: NDArray[np.float64],
    depth: float,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Return ``b_from_a`` (4, 4) with a random error, for points at a depth of ``depth`` metres.

    Camera b is rotated by up to 10 degrees and moved by up to 8 % of the depth. The angle
    and the distance are uniform, so that small errors are as frequent as large ones.
    """
    rotation = _direction(rng) * np.radians(_START_DEG) * rng.uniform()
    translation = _direction(rng) * _START_SHARE * depth * rng.uniform()
    error = np.eye(4)
    error[:3, :3] = so3_exp(torch.from_numpy(rotation)).numpy()
    error[:3, 3] = translation
    return error @ b_from_a


def cut_or_pad(
    size: int, points: NDArray[np.float64], *others: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], list[NDArray[np.float64]]]:
    """Cut or pad arrays to ``size`` rows; padding repeats the first row.

    Returns:
        Which rows are not padding, (size,) bool, and the arrays.
    """
    count = min(len(points), size)
    rows = np.concatenate([np.arange(count), np.zeros(size - count, np.int64)])
    return np.arange(size) < count, [array[rows] for array in (points, *others)]


def _direction(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a random unit vector (3,)."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)
