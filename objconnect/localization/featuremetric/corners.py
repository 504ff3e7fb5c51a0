"""Corners of a map's photographs as additional 3D points, triangulated by a plane sweep.

A sparse map has points where SIFT found texture in one season. Most of them lie on open ground,
where snow hides them. Corners of roofs, roads, walls and tree crowns remain visible.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from objconnect.localization.cache.map_cache import EarlierRows, MapCache
from objconnect.localization.cache.store import Row, Rows
from objconnect.localization.depth.sweep import BORDER_PX, Sweeper, SweepOptions
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.runtime.threads import map_in_threads
from objconnect.scene.storage.digests import digest_of

_FORMAT: Final = 5


class CornerOptions(SweepOptions):
    """Options of corners and of the plane sweep that triangulates them."""

    count: int = Field(2500, ge=1, description="Maximum number of corners of a photograph.")


_CORNERS: Final = CornerOptions()
# Least distance between corners, px.
_MIN_DISTANCE_PX: Final = 4.0
# Least strength of a corner as a share of the strongest. It is so low that ``CornerOptions.count``
# limits the number of corners.
_QUALITY: Final = 1e-3
# Sigma of the blur that removes sensor noise before detection.
_BLUR_PX: Final = 1.0


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
    """Finds and triangulates the corners of a map's photographs.

    Args:
        sparse_map: the map; its points tell which photographs overlap.
        images: folder of the photographs.
        longest: larger photographs are resized to this longer side (px).
        options: options of corners and plane sweep.
    """

    def __init__(
        self,
        sparse_map: SparseMap,
        images: Path,
        longest: int,
        options: CornerOptions = _CORNERS,
    ) -> None:
        self._max_corners = options.count
        self._sweep = Sweeper(sparse_map, images, longest, options)

    def __call__(self, name: str) -> Corners:
        """Find the corners of one photograph; none if too few photographs overlap with it.

        Raises:
            InputError: a photograph is missing or damaged.
        """
        photograph = self._sweep.photograph(name)
        xy = _detect_corners(photograph.grey, self._max_corners)
        swept = self._sweep(name, xy)
        return Corners(photograph.in_photograph(xy[swept.sure]), swept.xyz[swept.sure])

    def digest_inputs(self, name: str, digests: Mapping[str, str]) -> str:
        """Return a digest of all inputs of a photograph's corners except the options."""
        return self._sweep.digest_inputs(name, digests)


def all_corners(
    find: CornerFinder, map_cache: MapCache, *parts: object
) -> list[NDArray[np.float64]]:
    """Return the corners (N, 3) of each photograph, world metres, computed unless they are cached.

    All methods share the cache file.

    Args:
        find: finds the corners of one photograph.
        map_cache: the cache, with the photographs' names and digests.
        parts: parts of the cache key: all options that affect the corners.

    Raises:
        InputError: a photograph is missing, damaged or changed meanwhile, or the cache file is
            damaged.
    """

    def rows(read_earlier: EarlierRows) -> Rows:
        def find_row(name: str) -> Row:
            key = digest_of(_FORMAT, *parts, find.digest_inputs(name, map_cache.digests))
            return key, read_earlier(key, ["xyz"]) or {"xyz": find(name).xyz}

        with progress_bar("corners of the map", len(map_cache.names)) as advance:
            found = map_in_threads(find_row, map_cache.names)
            for done, row in enumerate(found, 1):
                yield row
                advance(done)

    store = map_cache.store("corners", _FORMAT, *parts, rows=rows)
    return [store.read(row, "xyz") for row in range(len(store))]


def _detect_corners(grey: Tensor, max_corners: int) -> NDArray[np.float64]:
    """Return Shi-Tomasi corners (N, 2), pixels, the strongest first."""
    smooth = cv2.GaussianBlur(grey.numpy(), (0, 0), _BLUR_PX)
    corners = cv2.goodFeaturesToTrack(smooth, max_corners, _QUALITY, _MIN_DISTANCE_PX)
    if corners is None:
        return np.empty((0, 2))
    # OpenCV's origin is the centre of the first pixel.
    xy = corners[:, 0].astype(np.float64) + 0.5
    size = np.array(grey.shape[::-1])
    return np.asarray(xy[((xy >= BORDER_PX) & (xy <= size - BORDER_PX)).all(1)])
