"""Photometric augmentation: imitates changes of weather, sensor and hour of the day."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def augment(
    image: NDArray[np.uint8], rng: np.random.Generator, strength: float = 1.0
) -> NDArray[np.uint8]:
    """Change exposure, contrast, colour, shade and sharpness at random.

    Args:
        image: (H, W, 3) uint8 RGB.
        rng: random generator.
        strength: 0 changes nothing; 1 changes about as much as another season does.
    """
    if strength == 0:
        return image
    height, width = image.shape[:2]
    x = image.astype(np.float32) / 255
    x = np.clip(x, 1e-3, 1) ** np.float32(np.exp(rng.normal(0, 0.35 * strength)))
    if rng.uniform() < 0.3 * strength:
        # As under snow, bright and green ground turns white, and dark surfaces stay.
        brightness = x.max(2, keepdims=True)
        threshold = rng.uniform(0.2, 0.5)
        snow = np.clip((brightness - threshold) / 0.15, 0, 1) * np.float32(rng.uniform(0.4, 1))
        x = x * (1 - snow) + np.float32(rng.uniform(0.7, 0.95)) * snow
    if rng.uniform() < 0.5:
        # Shade of clouds is a smooth factor over the image.
        coarse = rng.normal(0, 0.35 * strength, (4, 4)).astype(np.float32)
        x = (
            x
            * np.exp(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC))[..., None]
        )
    mean = x.mean((0, 1), keepdims=True)
    x = (x - mean) * np.float32(np.exp(rng.normal(0, 0.3 * strength))) + mean
    x = x * np.exp(rng.normal(0, 0.12 * strength, 3)).astype(np.float32)
    x = x + np.float32(rng.normal(0, 0.08 * strength))
    if rng.uniform() < 0.25 * strength:
        x = np.repeat(x.mean(2, keepdims=True), 3, 2)
    if rng.uniform() < 0.3 * strength:
        x = cv2.GaussianBlur(x, (0, 0), rng.uniform(0.4, 1.2))
    if rng.uniform() < 0.5:
        noise = rng.uniform(0, 0.03 * strength)
        x = x + noise * rng.standard_normal(x.shape, np.float32)
    return (np.clip(x, 0, 1) * 255 + 0.5).astype(np.uint8)
