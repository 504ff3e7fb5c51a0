"""Square crops of photographs, resized and turned about the camera's axis, with their cameras."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from baselines.training.pairs import Pinhole


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
    height, width = image.shape[:2]
    resized = np.maximum(np.round(np.array([width, height]) * scale), 1).astype(int)
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    small = cv2.resize(image, resized.tolist(), interpolation=how)
    exact = resized / [width, height]
    turn = turned_by(angle)[:2, :2]
    shift = size / 2 - turn @ (centre * exact)
    # Pixels counted from the edge, as ours; OpenCV counts from the first centre.
    affine = np.column_stack([turn, shift + turn @ [0.5, 0.5] - 0.5])
    cut = cv2.warpAffine(small, affine, (size, size), flags=cv2.INTER_LINEAR)
    seen_by = Pinhole(camera.focal * scale, turn @ (camera.principal * exact) + shift)
    crop_from_camera = np.eye(4)
    crop_from_camera[:3, :3] = turned_by(angle)
    return Crop(np.asarray(cut, np.uint8), seen_by, crop_from_camera)


def turned_by(angle: float) -> NDArray[np.float64]:
    """Rotation (3, 3) of camera coordinates when the picture turns counter-clockwise (rad)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
