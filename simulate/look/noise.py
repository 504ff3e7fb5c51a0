"""Noise images that vary the colours of surfaces."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def noise(rng: np.random.Generator, n: int, cells: float) -> NDArray[np.float32]:
    """Return smooth noise (n, n) with mean 0 and standard deviation about 0.5.

    It is interpolated from a coarse grid of about ``cells`` cells per side.
    """
    m = int(np.clip(round(cells), 2, n)) + 3
    coarse = rng.standard_normal((m, m), np.float32)
    fine = cv2.resize(coarse, (n, n), interpolation=cv2.INTER_CUBIC)
    return np.asarray(fine * np.float32(0.7))


def grain(rng: np.random.Generator, n: int) -> NDArray[np.float32]:
    """Return white noise (n, n) that repeats every 509 texels, which is not visible."""
    tile = rng.standard_normal((509, 509), np.float32) * np.float32(0.5)
    repeat = -(-n // 509)
    return np.tile(tile, (repeat, repeat))[:n, :n]
