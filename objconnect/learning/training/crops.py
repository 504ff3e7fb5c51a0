"""Square crops of photographs, resized and rotated about the optical axis, with their cameras."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from objconnect.learning.training.pairs import Pinhole
from objconnect.scene.geometry.views import resample, roll_rotation


class Crop(NamedTuple):
    """A square crop of a photograph.

    Attributes:
        image: (S, S, 3) uint8; black outside the photograph.
        camera: camera of the crop.
        crop_from_camera: rotation (4, 4) from the photograph's camera frame to the crop's.
        affine: (2, 3) map from pixels of the photograph to pixels of the crop.
    """

    image: NDArray[np.uint8]
    camera: Pinhole
    crop_from_camera: NDArray[np.float64]
    affine: NDArray[np.float64]

    def contains(self, xy: NDArray[np.float64], border: float) -> NDArray[np.bool_]:
        """Return whether pixels (N, 2) lie in the crop, ``border`` pixels or more from its edge."""
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
    """Cut a square around a pixel of a photograph, resized and rotated.

    Args:
        image: the photograph (H, W, 3).
        camera: camera of the photograph, with square pixels.
        centre: pixel (2,) of the photograph that becomes the middle of the crop.
        scale: pixels of the crop per pixel of the photograph.
        size: side S of the crop, pixels.
        angle: counter-clockwise rotation, radians.
    """
    rotation = roll_rotation(angle)
    linear = scale * rotation[:2, :2]
    affine = np.column_stack([linear, size / 2 - linear @ centre])
    cropped = resample(image, affine, np.array([size, size]))
    crop_camera = Pinhole(camera.focal * scale, linear @ camera.principal + affine[:, 2])
    crop_from_camera = np.eye(4)
    crop_from_camera[:3, :3] = rotation
    return Crop(cropped, crop_camera, crop_from_camera, affine)
