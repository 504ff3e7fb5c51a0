"""Pairs of a plane seen by two cameras: truth without a renderer."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.learning.training.pairs import Pair, PairBatch, Pinhole, collate, perturb_transform

_DEPTH = 48.0


def picture(height: int, width: int, seed: int = 0) -> NDArray[np.uint8]:
    """Blots of colour about 16 pixels wide."""
    rng = np.random.default_rng(seed)
    small = rng.integers(0, 256, (height // 16 + 2, width // 16 + 2, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC))


def pairs(batch: int = 2, size: int = 96, count: int = 64) -> PairBatch:
    """A plane under a camera that moves sideways and sees exactly what it saw, shifted."""
    rng = np.random.default_rng(0)
    camera = Pinhole(np.full(2, 96.0), np.full(2, size / 2))
    shift = 4
    moved = np.eye(4)
    moved[0, 3] = -shift * _DEPTH / 96
    made = []
    for number in range(batch):
        wide = picture(size, size + shift, number)
        xy = rng.uniform(12, size - 12, (count, 2))
        points = camera.lift(xy, np.full(count, _DEPTH))
        seen = camera.project(points + moved[:3, 3])
        start = perturb_transform(moved, _DEPTH, rng)
        images = wide[:, :size], wide[:, shift:]
        made.append(
            Pair(*images, camera, camera, moved, start, points, xy, seen, np.ones(count, bool))
        )
    return collate(made)
