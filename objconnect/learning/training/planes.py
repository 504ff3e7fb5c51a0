"""Training pairs from single photographs, each treated as flat ground that two cameras see.

Networks can thus be trained on real photographs, as in HomographyNet and SuperPoint (DeTone et al.,
2016 and 2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.learning.training.augment import augment
from objconnect.learning.training.keypoints import keypoints
from objconnect.learning.training.options import PAIRS, PairOptions
from objconnect.learning.training.pairs import (
    BORDER_PX,
    MIN_POINTS,
    Pair,
    Pinhole,
    cut_or_pad,
    perturb_transform,
)
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import so3_exp
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.listing import PHOTOGRAPHS, list_files

# Distance (m) of the virtual cameras to the ground along the optical axis. Each camera has 0.85 to
# 1.2 times this distance.
_HEIGHT_M: Final = 80.0
# Largest tilt of the virtual cameras about each axis.
_TILT_DEG: Final = 15.0


class PlanePairs:
    """Draws pairs from folders of photographs. Implements ``PairSource``.

    Args:
        folders: folders of photographs, which are searched with their subfolders.
        size: side of the images of pairs, pixels.
        points: number of points of a pair.
        strength: strength of the photometric augmentation, 0 to 1.
        options: options of pairs.

    Raises:
        InputError: there is no photograph.
    """

    def __init__(
        self,
        folders: Sequence[Path],
        size: int,
        points: int,
        strength: float,
        options: PairOptions = PAIRS,
    ) -> None:
        self._paths = sorted(
            path for folder in folders for path in list_files(folder, PHOTOGRAPHS, depth=None)
        )
        if not self._paths:
            raise InputError(f"no photographs ({', '.join(PHOTOGRAPHS)}) in {folders[0]}")
        self._size, self._points, self._strength = size, points, strength
        self._options = options

    def draw(self, rng: np.random.Generator) -> Pair:
        """See ``PairSource``."""
        while True:
            photograph = read_rgb(self._paths[rng.integers(len(self._paths))])
            pair = self._render_pair(photograph, rng)
            if pair is not None:
                return pair

    def _render_pair(self, photograph: NDArray[np.uint8], rng: np.random.Generator) -> Pair | None:
        """Return a pair of views of a photograph; None if they share too few points."""
        size, (height, width) = self._size, photograph.shape[:2]
        options = self._options
        camera = Pinhole(np.full(2, rng.uniform(0.8, 1.4) * size), np.full(2, size / 2))
        # The views show the photograph at about 0.5 to 1.2 times its scale.
        metres_per_pixel = _HEIGHT_M / camera.focal[0] * rng.uniform(0.5, 1.2)
        middle = np.array([width, height]) * rng.uniform(0.3, 0.7, 2) * metres_per_pixel
        a_from_ground = _draw_pose(middle, rng, options)
        offset = rng.uniform(-0.15, 0.15, 2) * size / camera.focal[0] * _HEIGHT_M
        b_from_ground = _draw_pose(middle + offset, rng, options)
        b_from_a = b_from_ground @ np.linalg.inv(a_from_ground)
        image_a = _render(photograph, metres_per_pixel, camera, a_from_ground, size)
        image_b = _render(photograph, metres_per_pixel, camera, b_from_ground, size)
        xy_a = keypoints(image_a, 4 * self._points, rng)
        # The points are where rays meet the ground, z = 0.
        rays = camera.lift(xy_a, np.ones(len(xy_a)))
        ground_from_a = np.linalg.inv(a_from_ground)
        directions = rays @ ground_from_a[:3, :3].T
        depth = -ground_from_a[2, 3] / directions[:, 2]
        points = rays * depth[:, None]
        xy_b = camera.project(points @ b_from_a[:3, :3].T + b_from_a[:3, 3])
        on_ground = (directions * depth[:, None] + ground_from_a[:3, 3])[:, :2]
        in_photograph = on_ground / metres_per_pixel
        xy = np.concatenate([xy_a, xy_b], 1)
        border = BORDER_PX
        shown = ((xy > border) & (xy < size - border)).all(1)
        shown &= ((in_photograph > 1) & (in_photograph < [width - 1, height - 1])).all(1)
        if shown.sum() < MIN_POINTS:
            return None
        valid, (points, xy_a, xy_b) = cut_or_pad(
            self._points, points[shown], xy_a[shown], xy_b[shown]
        )
        return Pair(
            augment(image_a, rng, self._strength),
            augment(image_b, rng, self._strength),
            camera,
            camera,
            b_from_a,
            perturb_transform(b_from_a, float(np.median(depth)), rng),
            points,
            xy_a,
            xy_b,
            valid,
        )


def _draw_pose(
    target: NDArray[np.float64], rng: np.random.Generator, options: PairOptions
) -> NDArray[np.float64]:
    """Return a random ``camera_from_ground`` (4, 4) of a camera that looks down at a point (2,).

    The ground has its x axis to the right of the photograph and its y axis down, metres.
    """
    height = _HEIGHT_M * rng.uniform(0.85, 1.2)
    tilt = np.radians(rng.uniform(-_TILT_DEG, _TILT_DEG, 2))
    # The input of networks is rotated north up. This is the error of the heading.
    heading = np.radians(rng.uniform(-options.heading_deg, options.heading_deg))
    rotation = so3_exp(torch.tensor([*tilt, 0.0])) @ so3_exp(torch.tensor([0.0, 0.0, heading]))
    pose = np.eye(4)
    pose[:3, :3] = rotation.numpy()
    # The point is in the middle of the picture, at a depth of ``height``.
    pose[:3, 3] = [0, 0, height] - pose[:3, :3] @ [*target, 0]
    return pose


def _render(
    photograph: NDArray[np.uint8],
    metres_per_pixel: float,
    camera: Pinhole,
    camera_from_ground: NDArray[np.float64],
    size: int,
) -> NDArray[np.uint8]:
    """Return the camera's view (size, size, 3) of a photograph that lies on the ground."""
    K = np.array(
        [
            [camera.focal[0], 0, camera.principal[0]],
            [0, camera.focal[1], camera.principal[1]],
            [0, 0, 1],
        ]
    )
    image_from_photograph = (
        K @ camera_from_ground[:3][:, [0, 1, 3]] @ np.diag([metres_per_pixel, metres_per_pixel, 1])
    )
    # Pixel centres are at halves here, and at whole numbers in OpenCV.
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    shifted = np.linalg.inv(half) @ image_from_photograph @ half
    view = cv2.warpPerspective(
        photograph, shifted, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101
    )
    return np.asarray(view, np.uint8)
