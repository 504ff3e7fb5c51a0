"""Where to learn: mostly where a map has points."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from baselines.training.options import PAIRS, PairOptions


def keypoints(
    image: NDArray[np.uint8], count: int, rng: np.random.Generator, options: PairOptions = PAIRS
) -> NDArray[np.float64]:
    """Pixels at FAST corners (Rosten and Drummond, ECCV 2006) and at random places, (count, 2).

    Args:
        image: (H, W, 3) uint8.
        count: of pixels; corners drawn with equal chance, whatever their strength.
        rng: draws them.
        options: which corners count, and how many points lie at them.
    """
    height, width = image.shape[:2]
    corners = cv2.FastFeatureDetector.create(options.corner_threshold).detect(image)
    chosen = rng.permutation(len(corners))[: round(count * options.corner_share)]
    at_corners = np.array([corners[k].pt for k in chosen], np.float64).reshape(-1, 2) + 0.5
    anywhere = rng.uniform(0, [width, height], (count - len(chosen), 2))
    return rng.permutation(np.concatenate([at_corners, anywhere]))
