"""Paint the raster of the ground cover from regions."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.labels import CLASSES
from simulate.place.world import Ground, Marking, Region

TEXEL_M = 0.1  # smallest side of a texel
MAX_TEXELS = 4096  # a side; larger places have coarser texels instead of larger images
SHIFT = 4  # fractional bits of OpenCV's sub-pixel drawing


def texel_size(side_m: float) -> float:
    """Return the side of a ground texel in metres, for a place of ``side_m`` metres a side."""
    return max(TEXEL_M, side_m / MAX_TEXELS)


def paint(
    side_m: float,
    regions: Iterable[Region],
    markings: Iterable[Marking],
    texel_m: float | None = None,
    base: str = "grass",
) -> Ground:
    """Paint regions over a base class on a raster of the whole area, later ones over earlier.

    Texels are about ``texel_m`` metres wide; None computes it by ``texel_size``.
    """
    n = round(side_m / (texel_m or texel_size(side_m)))
    texel = side_m / n
    labels = np.full((n, n), CLASSES[base], np.uint8)
    tone = np.full((n, n), 128, np.uint8)
    for region in regions:
        corners = [to_raster(region.polygon, texel, n)]
        cv2.fillPoly(labels, corners, CLASSES[region.class_name], shift=SHIFT)
        cv2.fillPoly(tone, corners, int(255 * region.tone), shift=SHIFT)
    return Ground(texel, labels, tone, tuple(markings))


def to_raster(points: NDArray[np.float64], texel: float, n: int) -> NDArray[np.int32]:
    """Convert world metres (K, 2) to OpenCV's fixed-point pixels, whose centres are integers."""
    pixels = points / texel + 0.5 * n - 0.5
    return np.asarray(np.round(pixels * (1 << SHIFT)), np.int32)
