"""Warps from a pixel and its inverse depth in one view to the pixel in another, and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scene.geometry.camera import Camera

_MIN_DEPTH = 1e-6


@dataclass(frozen=True)
class StereoView:
    """A photograph without distortion.

    Attributes:
        grey: (H, W) float32 in 0..1.
        camera: PINHOLE of that size.
        cam_from_world: (4, 4) float64.
    """

    grey: Tensor
    camera: Camera
    cam_from_world: NDArray[np.float64]

    @property
    def nbytes(self) -> int:
        """Bytes of its values."""
        return self.grey.nbytes


class Warped(NamedTuple):
    """Pixels ``u``, ``v`` of another view, ``z``: depth there over depth here (at least a
    millionth), and whether the point is in front of that view and in its picture."""

    u: Tensor
    v: Tensor
    z: Tensor
    seen: Tensor


@dataclass(frozen=True)
class Warp:
    """The homogeneous pixel ``rotation @ (x, y, 1) + w * translation``, linear in w = 1/z.

    Attributes:
        rotation: (3, 3).
        translation: (3,).
        height: of the other view.
        width: of the other view.
    """

    rotation: tuple[tuple[float, ...], ...]
    translation: tuple[float, ...]
    height: int
    width: int

    @staticmethod
    def between(here: StereoView, there: StereoView) -> Warp:
        relative = there.cam_from_world @ np.linalg.inv(here.cam_from_world)
        K = there.camera.calibration
        rotation = K @ relative[:3, :3] @ np.linalg.inv(here.camera.calibration)
        return Warp(
            tuple(tuple(row) for row in rotation.tolist()),
            tuple((K @ relative[:3, 3]).tolist()),
            there.camera.height,
            there.camera.width,
        )

    def __call__(self, x: Tensor, y: Tensor, w: Tensor) -> Warped:
        """Pixels and inverse depths of any one shape."""
        a, b, c = (
            row[0] * x + row[1] * y + (row[2] + shift * w)
            for row, shift in zip(self.rotation, self.translation, strict=True)
        )
        z = c.clamp_min(_MIN_DEPTH)
        u, v = a / z, b / z
        inside = (u > 0) & (u < self.width) & (v > 0) & (v < self.height)
        return Warped(u, v, z, inside & (c > _MIN_DEPTH))

    def slopes(self, at: Warped, gx: Tensor, gy: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """du/dx, du/dy, dv/dx, dv/dy along a plane whose inverse depth has the slope gx, gy."""
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
    there: Warp, back: Warp, inverse_depth: Tensor, x: Tensor, y: Tensor, w: Tensor
) -> tuple[Tensor, Tensor]:
    """Go to another view, take the depth its own map has, come back.

    Args:
        there: to the other view.
        back: from it.
        inverse_depth: (H, W) of the other view, 0 where unknown.
        x: pixels here.
        y: pixels here.
        w: inverse depths here.

    Returns:
        Pixels from where it began, and depth there as carried over the depth of the map minus one;
        both infinite where the other view does not see the point or knows no depth.
    """
    at = there(x, y, w)
    column = at.u.long().clamp(0, there.width - 1)
    row = at.v.long().clamp(0, there.height - 1)
    known = inverse_depth[row, column]
    home = back(at.u, at.v, known)
    met = at.seen & (known > 0)
    pixels = torch.hypot(home.u - x, home.v - y)
    return (
        torch.where(met, pixels, torch.inf),
        torch.where(met, at.z / w * known - 1, torch.inf),
    )
