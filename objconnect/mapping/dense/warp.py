"""Warps from a pixel and its inverse depth in one view to the pixel in another, and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.scene.geometry.camera import Camera

MIN_DEPTH_RATIO = 1e-6
"""Minimum ratio of the depths of a point in the other view and in the own view."""


@dataclass(frozen=True)
class StereoView:
    """An undistorted photograph with its pose.

    Attributes:
        grey: grey values (H, W) float32 in 0..1.
        camera: PINHOLE camera of that size.
        cam_from_world: pose (4, 4) float64.
    """

    grey: Tensor
    camera: Camera
    cam_from_world: NDArray[np.float64]

    @property
    def nbytes(self) -> int:
        """Return the number of bytes of its values."""
        return self.grey.nbytes


class WarpedPixels(NamedTuple):
    """Pixels ``u``, ``v`` in another view, and the ratio ``z`` of the depths in both views.

    ``z`` is the depth in the other view divided by the depth in the own view, at least a millionth.
    ``seen`` is whether the point is in front of the other view and inside its picture.
    """

    u: Tensor
    v: Tensor
    z: Tensor
    seen: Tensor


@dataclass(frozen=True)
class Warp:
    """The homogeneous pixel ``rotation @ (x, y, 1) + w * translation``; w is the inverse depth.

    Attributes:
        rotation: matrix (3, 3).
        translation: vector (3,).
        height: height of the other view, pixels.
        width: width of the other view, pixels.
    """

    rotation: tuple[tuple[float, ...], ...]
    translation: tuple[float, ...]
    height: int
    width: int

    @staticmethod
    def between(view: StereoView, other: StereoView) -> Warp:
        """Return the warp of pixels of ``view`` to pixels of ``other``."""
        relative = other.cam_from_world @ np.linalg.inv(view.cam_from_world)
        K = other.camera.calibration
        rotation = K @ relative[:3, :3] @ np.linalg.inv(view.camera.calibration)
        return Warp(
            tuple(tuple(row) for row in rotation.tolist()),
            tuple((K @ relative[:3, 3]).tolist()),
            other.camera.height,
            other.camera.width,
        )

    def __call__(self, x: Tensor, y: Tensor, w: Tensor) -> WarpedPixels:
        """Warp pixels with inverse depths, all of one shape."""
        a, b, c = (
            row[0] * x + row[1] * y + (row[2] + shift * w)
            for row, shift in zip(self.rotation, self.translation, strict=True)
        )
        z = c.clamp_min(MIN_DEPTH_RATIO)
        u, v = a / z, b / z
        inside = (u > 0) & (u < self.width) & (v > 0) & (v < self.height)
        return WarpedPixels(u, v, z, inside & (c > MIN_DEPTH_RATIO))

    def slopes(
        self, at: WarpedPixels, gx: Tensor, gy: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return du/dx, du/dy, dv/dx, dv/dy on a plane with inverse-depth slopes gx, gy."""
        (a0, a1, _), (b0, b1, _), (c0, c1, _) = self.rotation
        ta, tb, tc = self.translation
        zx, zy = c0 + tc * gx, c1 + tc * gy
        return (
            (a0 + ta * gx - at.u * zx) / at.z,
            (a1 + ta * gy - at.u * zy) / at.z,
            (b0 + tb * gx - at.v * zx) / at.z,
            (b1 + tb * gy - at.v * zy) / at.z,
        )


def round_trip(
    to_other: Warp, from_other: Warp, inverse_depth: Tensor, x: Tensor, y: Tensor, w: Tensor
) -> tuple[Tensor, Tensor]:
    """Warp pixels to another view, take the depth of its map at these pixels, and warp them
    back.

    Args:
        to_other: warp to the other view.
        from_other: warp from the other view.
        inverse_depth: inverse depth map (H, W) of the other view, 0 where unknown.
        x: columns of the pixels.
        y: rows of the pixels.
        w: inverse depths of the pixels.

    Returns:
        The distance in pixels after the round trip, and the relative difference of the warped depth
        from the map's depth. Both are infinite where the other view does not show the point or has
        no depth.
    """
    at = to_other(x, y, w)
    column = at.u.long().clamp(0, to_other.width - 1)
    row = at.v.long().clamp(0, to_other.height - 1)
    known = inverse_depth[row, column]
    returned = from_other(at.u, at.v, known)
    is_known = at.seen & (known > 0)
    pixels = torch.hypot(returned.u - x, returned.v - y)
    return (
        torch.where(is_known, pixels, torch.inf),
        torch.where(is_known, at.z / w * known - 1, torch.inf),
    )
