"""Points where photographs of a map show corners, placed by the photographs beside them.

A sparse map has its points where SIFT found texture, in one season: most lie on plain ground, and
snow hides them. What stays to be seen is corners of roofs, roads, walls and crowns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import h5py
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from baselines.sweep import Sweeper
from scene.errors import HDF5_DAMAGE, InputError
from scene.maps.sparse_map import SparseMap
from scene.runtime.progress import progress_bar
from scene.storage.files import written_whole
from scene.storage.hdf5 import array

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
        longest: photographs with a longer side (px) are made smaller.
    """

    def __init__(self, sparse_map: SparseMap, images: Path, most: int, longest: int) -> None:
        self._most = most
        self._sweep = Sweeper(sparse_map, images, longest)

    def __call__(self, name: str) -> Corners:
        """Of one photograph; none where it has too few neighbours.

        Raises:
            InputError: a photograph is missing or damaged.
        """
        look = self._sweep.look(name)
        xy = _corners(look.grey, self._most)
        found = self._sweep(name, xy)
        return Corners(look.in_photograph(xy[found.sure]), found.xyz[found.sure])


def all_corners(
    sparse_map: SparseMap,
    images: Path,
    most: int,
    longest: int,
    path: Path,
    check: Callable[[], None] = lambda: None,
) -> list[NDArray[np.float64]]:
    """Places (N, 3) of the corners of every photograph of a map, kept in a file for every method.

    Args:
        sparse_map: whose photographs.
        images: folder of the photographs.
        most: corners of a photograph.
        longest: see ``CornerFinder``.
        path: of the file.
        check: called before it is written; where it raises, nothing is kept.

    Raises:
        InputError: a photograph is missing or damaged, or the file is.
    """
    if not path.is_file():
        find = CornerFinder(sparse_map, images, most, longest)
        found = []
        with progress_bar("corners of the map", len(sparse_map.names)) as advance:
            for done, name in enumerate(sparse_map.names, 1):
                found.append(find(name).xyz)
                advance(done)
        check()
        with written_whole(path) as partial, h5py.File(partial, "w") as file:
            file["xyz"] = np.concatenate([np.empty((0, 3)), *found])
            file["ends"] = np.cumsum([len(xyz) for xyz in found])
    try:
        with h5py.File(path) as file:
            xyz, ends = array(file, "xyz"), array(file, "ends")
            return np.split(xyz, ends[:-1])
    except HDF5_DAMAGE as error:
        raise InputError(f"{path} is damaged ({error}): delete it") from None


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
