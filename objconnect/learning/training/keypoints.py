"""Pixels at which features are trained: mostly corners, because the points of maps are corners."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

# Threshold of FAST, grey levels.
_CORNER_THRESHOLD: Final = 8
# Share of the pixels at corners. The others are random, so that features of ground without texture
# are trained too.
_CORNER_SHARE: Final = 0.75


def keypoints(
    image: NDArray[np.uint8], count: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return pixels (count, 2) at FAST corners (Rosten and Drummond, ECCV 2006) and at random.

    Args:
        image: (H, W, 3) uint8.
        count: number of pixels; corners are drawn uniformly, whatever their strength.
        rng: random generator.
    """
    height, width = image.shape[:2]
    corners = cv2.FastFeatureDetector.create(_CORNER_THRESHOLD).detect(image)
    chosen = rng.permutation(len(corners))[: round(count * _CORNER_SHARE)]
    at_corners = np.array([corners[k].pt for k in chosen], np.float64).reshape(-1, 2) + 0.5
    anywhere = rng.uniform(0, [width, height], (count - len(chosen), 2))
    return rng.permutation(np.concatenate([at_corners, anywhere]))
