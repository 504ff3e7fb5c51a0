"""Points where photographs of a map show corners, placed by the photographs beside them.

A sparse map has its points where SIFT found texture, in one season: most lie on plain ground, and
snow hides them. What stays to be seen is corners of roofs, roads, walls and crowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from baselines.sweep import Sweeper
from scene.sparse_map import SparseMap

# Pixels between corners, and least strength of them as a share of the strongest.
_APART: Final = 4.0
_QUALITY: Final = 1e-3
_BORDER: Final = 8.0


@dataclass(frozen=True)
class Corners:
    """Corners of one photograph.

    Attributes:
        xy: (N, 2) pixels.
        xyz: (N, 3) world metres.
    """

    xy: NDArray[np.float64]
    xyz: NDArray[np.float64]


class CornerFinder:
    """Finds the corners of a map's photographs, one photograph after the other.

    Args:
        sparse_map: whose photographs, and points that say who sees the same.
        images: folder of the photographs.
        most: corners of a photograph.
    """

    def __init__(self, sparse_map: SparseMap, images: Path, most: int) -> None:
        self._most = most
        self._sweep = Sweeper(sparse_map, images)

    def __call__(self, name: str) -> Corners:
        """Of one photograph; none where it has too few neighbours.

        Raises:
            InputError: a photograph is missing or damaged.
        """
        xy = _corners(self._sweep.grey(name), self._most)
        found = self._sweep(name, xy)
        return Corners(xy[found.sure], found.xyz[found.sure])


def _corners(grey: Tensor, most: int) -> NDArray[np.float64]:
    """Shi and Tomasi's corners, (N, 2) pixels, the strongest first."""
    smooth = cv2.GaussianBlur(grey.numpy(), (0, 0), 1.0)
    found = cv2.goodFeaturesToTrack(smooth, most, _QUALITY, _APART)
    if found is None:
        return np.empty((0, 2))
    # OpenCV counts from the first pixel's centre.
    xy = found[:, 0].astype(np.float64) + 0.5
    size = np.array(grey.shape[::-1])
    return np.asarray(xy[((xy >= _BORDER) & (xy <= size - _BORDER)).all(1)])
