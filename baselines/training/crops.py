"""Square crops of photographs, resized and turned by quarter turns, with their cameras."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from baselines.training.pairs import Pinhole


class Crop(NamedTuple):
    """A square cut of a photograph.

    Attributes:
        image: (S, S, 3) uint8.
        camera: that sees it.
        corner: (2,) pixel of the photograph where it begins.
        scale: pixels of the crop per pixel of the photograph.
    """

    image: NDArray[np.uint8]
    camera: Pinhole
    corner: NDArray[np.float64]
    scale: float

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
) -> Crop:
    """Cut ``size / scale`` pixels around ``centre``, moved to lie inside, resized to ``size``."""
    height, width = image.shape[:2]
    side = min(round(size / scale), height, width)
    scale = size / side
    corner = np.clip(np.round(centre - side / 2), 0, [width - side, height - side])
    x, y = corner.astype(int)
    cut = image[y : y + side, x : x + side]
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    resized = cv2.resize(cut, (size, size), interpolation=how).astype(np.uint8)
    seen_by = Pinhole(camera.focal * scale, (camera.principal - corner) * scale)
    return Crop(resized, seen_by, corner, scale)


def quarter_turns(
    image: NDArray[np.uint8], camera: Pinhole, turns: int
) -> tuple[NDArray[np.uint8], Pinhole, NDArray[np.float64]]:
    """A square image turned counter-clockwise, its camera, and ``turned_from_camera`` (4, 4)."""
    size = float(len(image))
    (fx, fy), (cx, cy) = camera.focal, camera.principal
    turned = np.eye(4)
    for _ in range(turns % 4):
        # The pixel (x, y) goes to (y, size - x).
        fx, fy, cx, cy = fy, fx, cy, size - cx
        turned = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]) @ turned
    picture = np.ascontiguousarray(np.rot90(image, turns))
    return picture, Pinhole(np.array([fx, fy]), np.array([cx, cy])), turned
