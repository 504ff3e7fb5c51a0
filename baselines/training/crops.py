"""Square crops of photographs, resized and turned about the camera's axis, with their cameras."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.training.pairs import Pinhole
from baselines.views import resampled, roll_rotation


class Crop(NamedTuple):
    """A square cut of a photograph.

    Attributes:
        image: (S, S, 3) uint8; black where the photograph has ended.
        camera: that sees it.
        crop_from_camera: (4, 4) the turn from the photograph's camera frame to this camera's.
    """

    image: NDArray[np.uint8]
    camera: Pinhole
    crop_from_camera: NDArray[np.float64]

    def contains(self, xy: NDArray[np.float64], border: float) -> NDArray[np.bool_]:
        """Whether pixels of the crop (N, 2) lie inside it, ``border`` pixels from its edge."""
        inside = (xy >= border) & (xy <= len(self.image) - border)
        return np.asarray(inside.all(1))


def crop(
    image: NDArray[np.uint8],
    camera: Pinhole,
    centre: NDArray[np.float64],
    scale: float,
    size: int,
    angle: float = 0.0,
) -> Crop:
    """What lies around a pixel, resized and turned.

    Args:
        image: (H, W, 3) the photograph.
        camera: that took it, with square pixels.
        centre: (2,) pixel of the photograph that comes to the middle.
        scale: pixels of the crop per pixel of the photograph.
        size: S.
        angle: counter-clockwise, radians.
    """
    turn = roll_rotation(angle)
    linear = scale * turn[:2, :2]
    affine = np.column_stack([linear, size / 2 - linear @ centre])
    cut = resampled(image, affine, np.array([size, size]))
    seen_by = Pinhole(camera.focal * scale, linear @ camera.principal + affine[:, 2])
    crop_from_camera = np.eye(4)
    crop_from_camera[:3, :3] = turn
    return Crop(cut, seen_by, crop_from_camera)
