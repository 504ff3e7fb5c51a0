"""Features of a map's points in its photographs, computed once and kept on disk.

Only features at points are needed of the photographs, and these are few.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.localization.cache.array_store import ArrayStore, written_store
from objconnect.localization.cache.earlier import key_of
from objconnect.localization.cache.map_cache import MapCache
from objconnect.localization.featuremetric.corners import CornerFinder, CornerOptions, all_corners
from objconnect.localization.featuremetric.maps import FeatureMap, MapExtractor
from objconnect.localization.resolution import (
    metres_per_pixel,
    observed,
    of_map,
    scale_to,
)
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import WarpedImage, north_angle
from objconnect.scene.localizer import MapPart
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.runtime.memory import return_freed
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.lru_cache import LruCache, room

_FORMAT: Final = 5
# Points seen by fewer photographs are left out, as by PixLoc's authors.
_MIN_TRACK: Final = 3
# Photographs with fewer reliable points keep all their points.
_MIN_POINTS: Final = 64
POINTS: Final = 2048
"""Points of a photograph, and of all references of a query together, which bounds time."""
GRID: Final = 16
"""Points are taken in turns from the cells of a grid of this many by this many over a picture."""


class Watch(Protocol):
    """Sees feature maps of a map's photographs while these are computed."""

    def lacks(self, image: MapImage, key: str) -> bool:
        """Return whether it needs to see a photograph; ``key`` is that of ``MapViews``."""
        ...

    def __call__(
        self, image: MapImage, key: str, view: WarpedImage, maps: list[FeatureMap]
    ) -> None:
        """See a photograph."""
        ...

    def write(self) -> None:
        """Keep what was found in a file of the cache."""
        ...


@dataclass(frozen=True)
class ReferenceSource:
    """What the observations of a map's photographs are computed from.

    Attributes:
        sparse_map: the map.
        images: folder of its photographs.
        extract: computes feature maps.
        extractor_key: identifies the network's weights and its options, for the cache.
        name: of the method, used for files and progress.
        points: most points to keep of a photograph.
        corners: corners of a photograph that become points; None for none.
    """

    sparse_map: SparseMap
    images: Path
    extract: MapExtractor
    extractor_key: str
    name: str
    points: int = POINTS
    corners: CornerOptions | None = None

    def path(self, kept: MapCache) -> Path:
        """Return the path of the file of observations in a cache."""
        corners = self.corners and self.corners.model_dump_json()
        return kept.path(self.name, _FORMAT, self.points, corners, self.extractor_key)


@dataclass(frozen=True)
class Observations:
    """Points of the map as one photograph shows them, N in all.

    Any first few of them are spread over the photograph.

    Attributes:
        xyz: (N, 3) world metres.
        features: per level, coarse to fine, (N, C) float16 of unit length.
        confidence: (N, L) float16 in 0..1.
    """

    xyz: NDArray[np.float64]
    features: tuple[NDArray[np.float16], ...]
    confidence: NDArray[np.float16]

    @property
    def nbytes(self) -> int:
        """Memory taken."""
        return self.xyz.nbytes + self.confidence.nbytes + sum(f.nbytes for f in self.features)


class ReferenceFeatures:
    """Observations of all photographs of a map, in a file; the last used also in memory.

    Threads may share it.

    Args:
        path: written by ``references``.
        memory: bytes that observations in memory may take.

    Attributes:
        metres_per_pixel: at which the photographs were seen, NaN if not known.
    """

    def __init__(self, path: Path, memory: int) -> None:
        self._store = ArrayStore(path)
        names = _names(int(self._store.attribute("levels")))
        self._cache = LruCache(partial(_read, self._store, names), memory)
        self.metres_per_pixel = float(self._store.attribute("metres_per_pixel"))

    def __len__(self) -> int:
        return len(self._store)

    def __getitem__(self, photograph: int) -> Observations:
        """Return the observations of a photograph, given its row in ``SparseMap.names``."""
        return self._cache(photograph)

    def coarse(self, photograph: int) -> NDArray[np.float32]:
        """Read the features of a photograph's coarsest level alone, (N, C), past the cache."""
        return self._store.read(photograph, "features/0").astype(np.float32)


def _names(levels: int) -> list[str]:
    """Return the names of the arrays of a photograph."""
    return ["xyz", "confidence", *(f"features/{level}" for level in range(levels))]


def _read(store: ArrayStore, names: Sequence[str], photograph: int) -> Observations:
    xyz, confidence, *features = (store.read(photograph, name) for name in names)
    return Observations(xyz, tuple(features), confidence)


def references(
    source: ReferenceSource, cache: Path, memory_mb: int, watch: Watch | None = None
) -> ReferenceFeatures:
    """Return the observations of a map's photographs, from the cache where it holds them.

    Args:
        source: what they are computed from.
        cache: folder of files, each named by a digest of all that decides its content.
        memory_mb: for the whole process; observations stay in memory as far as there is room.
        watch: sees the feature maps, where these are computed.

    Raises:
        InputError: a photograph is missing, broken, not of its camera's size, or changed meanwhile.
    """
    kept = MapCache.of(source.sparse_map, source.images, cache)
    path = source.path(kept)
    if not path.is_file():
        _write_references(source, kept, watch)
    return ReferenceFeatures(path, room(memory_mb))


def write_part(source: ReferenceSource, cache: Path, part: MapPart, watch: Watch | None) -> None:
    """Compute the observations of a part of a map's photographs, unless the cache holds all.

    The arguments and errors are those of ``references``, which copies what this has written.
    """
    kept = MapCache.of(source.sparse_map, source.images, cache)
    if not source.path(kept).is_file():
        _write_references(source, replace(kept, part=part), watch)
        if watch is not None:
            watch.write()


def _write_references(source: ReferenceSource, kept: MapCache, watch: Watch | None) -> None:
    """Run the network on photographs of a map and keep the features at their points.

    Args:
        source: what the observations are computed from.
        kept: the cache, whose earlier files may hold what did not change.
        watch: sees the feature maps.
    """
    sparse_map, path = source.sparse_map, source.path(kept)
    posed = [sparse_map.images[name] for name in kept.names]
    corner_points = [np.empty((0, 3))] * len(posed)
    if source.corners is not None:
        longest = source.extract.longest
        find = CornerFinder(sparse_map, source.images, longest, source.corners)
        corner_points = all_corners(find, kept, longest, source.corners.model_dump_json())
    views, earlier = MapViews(source), kept.earlier(source.name)
    levels = len(source.extract.network.config.strides)
    names = _names(levels)
    with (
        written_store(path, levels=levels, metres_per_pixel=views.metres_per_pixel) as add,
        progress_bar(f"{source.name} map features", len(posed)) as advance,
    ):
        for done, (image, corners) in enumerate(zip(posed, corner_points, strict=True), 1):
            points = np.concatenate([_reliable_points(image, sparse_map), corners])
            seen_as = views.key(image, kept.digests[image.name])
            key = key_of(_FORMAT, seen_as, image.cam_from_world, points, source.points)
            arrays = earlier.read(key, lambda store, row: store.arrays(row, names))
            if arrays is None or (watch is not None and watch.lacks(image, seen_as)):
                view, maps = views(image)
                if watch is not None:
                    watch(image, seen_as, view, maps)
                seen = observe(view, maps, image.pose, points, source.points)
                arrays = dict(zip(names, (seen.xyz, seen.confidence, *seen.features), strict=True))
                del view, maps
                return_freed()
            add(arrays, key)
            advance(done)
        kept.require_unchanged()


class MapViews:
    """Photographs of a map as the network sees them: north up, at the resolution of the map.

    Args:
        source: the map, its photographs and the network.

    Attributes:
        metres_per_pixel: the resolution of the map, NaN if not known.
    """

    def __init__(self, source: ReferenceSource) -> None:
        self._source = source
        self.metres_per_pixel = of_map(source.sparse_map, source.extract.largest_scale)

    def __call__(self, image: MapImage) -> tuple[WarpedImage, list[FeatureMap]]:
        """Return a photograph as it is seen, and its feature maps.

        Raises:
            InputError: the photograph is missing, broken or not of its camera's size.
        """
        rgb = read_rgb(self._source.images / image.name, image.camera)
        return self._source.extract(rgb, image.camera, *self._turned_and_scaled(image))

    def key(self, image: MapImage, sha256: str) -> str:
        """Return a digest of all that the feature maps of a photograph are made of.

        Args:
            image: the photograph.
            sha256: digest of its bytes.
        """
        how = self._turned_and_scaled(image)
        return key_of(sha256, image.camera, *how, self._source.extractor_key)

    def _turned_and_scaled(self, image: MapImage) -> tuple[float, float]:
        """Return by how much a photograph is turned (rad) and resized."""
        source = self._source
        own = metres_per_pixel(image.pose, image.camera, observed(image, source.sparse_map))
        largest = source.extract.largest_scale(image.camera)
        scale = scale_to(self.metres_per_pixel, own, largest)
        return north_angle(image.cam_from_world[:3, :3]), scale


def observe(
    view: WarpedImage,
    maps: list[FeatureMap],
    pose: Pose,
    xyz: NDArray[np.float64],
    points: int,
) -> Observations:
    """Return the features of points in a photograph, at most ``points`` of those it shows.

    Features are taken where the points project, as PixLoc's authors do, not where they were
    observed. Among neighbours, the point with the highest confidence comes first.

    Args:
        view: the photograph, warped.
        maps: feature maps of the view.
        pose: ``cam_from_world`` of the photograph.
        xyz: (M, 3) the points.
        points: most to keep.
    """
    projected = view.camera.project(view.pose(pose).transform(torch.from_numpy(xyz)))
    inside = (projected.valid & view.camera.contains(projected.xy)).numpy()
    levels = [level.sample(projected.xy.float()) for level in maps]
    confidence = torch.stack([c for _, c in levels], -1)
    seen = np.flatnonzero(inside & (confidence > 0).all(-1).numpy())
    size = np.array([view.camera.width, view.camera.height])
    worth = confidence.log().sum(-1).numpy()[seen]
    kept = seen[spaced_order(projected.xy.numpy()[seen] / size, worth)[:points]]
    return Observations(
        xyz[kept],
        tuple(features[kept].to(torch.float16).numpy() for features, _ in levels),
        confidence[kept].to(torch.float16).numpy(),
    )


def _reliable_points(image: MapImage, sparse_map: SparseMap) -> NDArray[np.float64]:
    """Return the reliable points that a photograph observes, (N, 3), or all where they are few."""
    rows = np.unique(image.point_rows[image.point_rows >= 0])
    reliable = rows[sparse_map.track_length[rows] >= _MIN_TRACK]
    return np.asarray(sparse_map.xyz[reliable if len(reliable) >= _MIN_POINTS else rows])


def spaced_order(
    xy: NDArray[np.float64], worth: NDArray[Any], grid: int = GRID
) -> NDArray[np.int64]:
    """Order points so that any first few of them cover the picture.

    The worthiest point of every cell of a grid comes first, then the second of every cell, and so
    on.

    Args:
        xy: (N, 2) in 0..1.
        worth: (N,) the larger the earlier.
        grid: cells along each side of the picture.

    Example:
        >>> xy = np.array([[0.1, 0.1], [0.2, 0.2], [0.9, 0.9]])
        >>> spaced_order(xy, np.array([1, 3, 2]), grid=2).tolist()
        [1, 2, 0]
    """
    by_worth = np.argsort(-worth, kind="stable")
    column, row = np.clip((xy[by_worth] * grid).astype(int), 0, grid - 1).T
    cell = row * grid + column
    by_cell = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[by_cell], cell)
    place = np.empty(len(cell), np.int64)
    place[by_cell] = np.arange(len(cell))
    return by_worth[np.argsort(place - first, kind="stable")]
