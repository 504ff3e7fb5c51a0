"""Training pairs from single photographs, which are warped as flat ground seen by two cameras.

They train networks on real photographs, as in HomographyNet and SuperPoint (DeTone et al., 2016 and
2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.learning.training.augment import photometric
from objconnect.learning.training.keypoints import keypoints
from objconnect.learning.training.options import PAIRS, PairOptions
from objconnect.learning.training.pairs import (
    BORDER_PX,
    MIN_POINTS,
    Pair,
    Pinhole,
    fill,
    wrong_start,
)
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import so3_exp
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.listing import PHOTOGRAPHS, list_files

# Height (m) of the virtual cameras over the ground.
_HEIGHT_M: Final = 80.0
# Largest tilt of the virtual cameras about each axis.
_TILT_DEG: Final = 15.0


class PlanePairs:
    """Draws pairs from folders of photographs. Implements ``PairSource``."""

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
        size, (height, width) = self._size, photograph.shape[:2]
        options = self._options
        camera = Pinhole(np.full(2, rng.uniform(0.8, 1.4) * size), np.full(2, size / 2))
        # Metres of ground per pixel of the photograph; crops show it at 0.5 to 1.2 times its scale.
        ground = _HEIGHT_M / camera.focal[0] * rng.uniform(0.5, 1.2)
        middle = np.array([width, height]) * rng.uniform(0.3, 0.7, 2) * ground
        a_from_ground = _looking_down(middle, rng, options)
        away = rng.uniform(-0.15, 0.15, 2) * size / camera.focal[0] * _HEIGHT_M
        b_from_ground = _looking_down(middle + away, rng, options)
        b_from_a = b_from_ground @ np.linalg.inv(a_from_ground)
        image_a = _render(photograph, ground, camera, a_from_ground, size)
        image_b = _render(photograph, ground, camera, b_from_ground, size)
        xy_a = keypoints(image_a, 4 * self._points, rng)
        # The points are where rays meet the ground, z = 0.
        rays = camera.lift(xy_a, np.ones(len(xy_a)))
        ground_from_a = np.linalg.inv(a_from_ground)
        directions = rays @ ground_from_a[:3, :3].T
        depth = -ground_from_a[2, 3] / directions[:, 2]
        points = rays * depth[:, None]
        xy_b = camera.project(points @ b_from_a[:3, :3].T + b_from_a[:3, 3])
        on_ground = (directions * depth[:, None] + ground_from_a[:3, 3])[:, :2] / ground
        both = np.concatenate([xy_a, xy_b], 1)
        border = BORDER_PX
        good = ((both > border) & (both < size - border)).all(1)
        good &= ((on_ground > 1) & (on_ground < [width - 1, height - 1])).all(1)
        if good.sum() < MIN_POINTS:
            return None
        valid, (points, xy_a, xy_b) = fill(self._points, points[good], xy_a[good], xy_b[good])
        return Pair(
            photometric(image_a, rng, self._strength),
            photometric(image_b, rng, self._strength),
            camera,
            camera,
            b_from_a,
            wrong_start(b_from_a, float(np.median(depth)), rng),
            points,
            xy_a,
            xy_b,
            valid,
        )


def _looking_down(
    over: NDArray[np.float64], rng: np.random.Generator, options: PairOptions
) -> NDArray[np.float64]:
    """Return a random ``camera_from_ground`` (4, 4) over a point; ground x right, y down."""
    height = _HEIGHT_M * rng.uniform(0.85, 1.2)
    tilt = np.radians(rng.uniform(-_TILT_DEG, _TILT_DEG, 2))
    # The input of networks is rotated north up; this is the error of the heading.
    heading = np.radians(rng.uniform(-options.heading_deg, options.heading_deg))
    turn = so3_exp(torch.tensor([*tilt, 0.0])) @ so3_exp(torch.tensor([0.0, 0.0, heading]))
    pose = np.eye(4)
    pose[:3, :3] = turn.numpy()
    # The point below the camera is in the middle of the picture.
    pose[:3, 3] = [0, 0, height] - pose[:3, :3] @ [*over, 0]
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
    # Our pixel centres are at halves, and OpenCV's at whole numbers.
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    shifted = np.linalg.inv(half) @ image_from_photograph @ half
    seen = cv2.warpPerspective(
        photograph, shifted, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101
    )
    return np.asarray(seen, np.uint8)
