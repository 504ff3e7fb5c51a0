"""Features of a map's points in its photographs, computed once and kept on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Final, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.localization.cache.map_cache import EarlierRows, MapCache
from objconnect.localization.cache.store import Rows, Store
from objconnect.localization.featuremetric.corners import CornerFinder, CornerOptions, all_corners
from objconnect.localization.featuremetric.maps import FeatureMap, MapExtractor
from objconnect.localization.resolution import (
    map_resolution,
    metres_per_pixel,
    observed_xyz,
    scale_to,
)
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import WarpedImage, north_angle
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.runtime.tuning import trim_heap
from objconnect.scene.storage.digests import digest_of
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.lru_cache import LruCache, free_cache_bytes

_FORMAT: Final = 6
# Points seen by fewer photographs are left out, as in PixLoc.
_MIN_TRACK: Final = 3
# Photographs with fewer reliable points keep all their points.
_MIN_POINTS: Final = 64
MAX_POINTS: Final = 2048
"""Maximum number of points of a photograph, and of all reference images of a query together."""
GRID: Final = 16
"""Cells along each side of the grid that spreads points over a picture."""


class FeatureObserver(Protocol):
    """Receives the feature maps of a map's photographs while they are computed."""

    def needs(self, image: MapImage, key: str) -> bool:
        """Return whether the observer still needs a photograph; ``key`` is its ``MapViews.key``."""
        ...

    def __call__(
        self, image: MapImage, key: str, view: WarpedImage, maps: list[FeatureMap]
    ) -> None:
        """Receive a warped photograph and its feature maps; ``key`` is its ``MapViews.key``."""
        ...

    def write(self) -> None:
        """Write the results to a file of the cache."""
        ...


@dataclass(frozen=True)
class ReferenceSource:
    """The inputs from which the observations of a map's photographs are computed.

    Attributes:
        map_cache: the map, its photographs and the cache.
        extract: computes feature maps.
        extractor_key: identifies the network's weights and its options, for the cache.
        name: name of the method, for files and progress.
        points: maximum number of points of a photograph.
        corners: options of corners that become points; None for no corners.
    """

    map_cache: MapCache
    extract: MapExtractor
    extractor_key: str
    name: str
    points: int = MAX_POINTS
    corners: CornerOptions | None = None

    @property
    def identity(self) -> tuple[object, ...]:
        """Return the parts of the cache key in addition to the map and its photographs."""
        corners = self.corners and self.corners.model_dump_json()
        return _FORMAT, self.points, corners, self.extractor_key

    @property
    def array_names(self) -> list[str]:
        """Return the names of the arrays that the cache holds for each photograph."""
        levels = range(len(self.extract.network.config.strides))
        return ["xyz", "confidence", *(f"features {level}" for level in levels)]

    @cached_property
    def target_resolution(self) -> float:
        """Return the ground resolution (m/px) to which the photographs are resized; NaN if
        unknown."""
        return map_resolution(self.map_cache.sparse_map, self.extract.largest_scale)


@dataclass(frozen=True)
class Observations:
    """N points of the map with their features in one photograph.

    The first n points are spread over the photograph, for every n.

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
        """Return the bytes of all arrays."""
        return self.xyz.nbytes + self.confidence.nbytes + sum(f.nbytes for f in self.features)


class ReferenceFeatures:
    """Observations of all photographs of a map, in a file with a least-recently-used cache.

    Threads may share it.

    Args:
        store: the file.
        names: names of the arrays of a photograph.
        target_resolution: ground resolution of the resized photographs, m/px; NaN if unknown.
        memory: bound of the cache in memory, bytes.
    """

    def __init__(
        self, store: Store, names: Sequence[str], target_resolution: float, memory: int
    ) -> None:
        self._store, self.target_resolution = store, target_resolution
        self._cache = LruCache(partial(_read, store, names), memory)

    def __len__(self) -> int:
        return len(self._store)

    def __getitem__(self, photograph: int) -> Observations:
        """Return the observations of a photograph, given its row in ``SparseMap.names``."""
        return self._cache(photograph)

    def read_coarse(self, photograph: int) -> NDArray[np.float32]:
        """Read the features (N, C) of a photograph's coarsest level, without the cache."""
        return self._store.read(photograph, "features 0").astype(np.float32)


def _read(store: Store, names: Sequence[str], photograph: int) -> Observations:
    xyz, confidence, *features = store.arrays(photograph, names).values()
    return Observations(xyz, tuple(features), confidence)


def load_references(
    source: ReferenceSource, memory_mb: int, observer: FeatureObserver | None = None
) -> ReferenceFeatures:
    """Return the observations of a map's photographs, computed unless the cache holds them.

    Args:
        source: the inputs of the observations.
        memory_mb: memory of the whole process, MB; observations stay in memory as far as there is
            room.
        observer: receives the feature maps that are computed; None if none is needed.

    Raises:
        InputError: a photograph is broken or changed meanwhile.
    """
    store = source.map_cache.store(
        source.name, *source.identity, rows=partial(_compute_rows, source, observer)
    )
    return ReferenceFeatures(
        store, source.array_names, source.target_resolution, free_cache_bytes(memory_mb)
    )


def write_part(source: ReferenceSource, observer: FeatureObserver | None) -> None:
    """Write the observations of a part of a map's photographs, unless the cache holds all.

    When the whole map is prepared, ``load_references`` copies the observations of the parts instead
    of computing them.

    Args:
        source: the inputs of the observations. ``source.map_cache.part`` lists the photographs.
        observer: receives the feature maps that are computed; None if none is needed.

    Raises:
        InputError: a photograph is broken or changed meanwhile.
    """
    if not source.map_cache.holds(source.name, *source.identity):
        load_references(source, 0, observer)
        if observer is not None:
            observer.write()


def _compute_rows(
    source: ReferenceSource, observer: FeatureObserver | None, read_earlier: EarlierRows
) -> Rows:
    """Run the network on photographs of a map and yield the features at their points."""
    map_cache = source.map_cache
    images = [map_cache.sparse_map.images[name] for name in map_cache.names]
    corner_points = [np.empty((0, 3))] * len(images)
    if source.corners is not None:
        longest = source.extract.longest
        find = CornerFinder(map_cache.sparse_map, map_cache.images, longest, source.corners)
        corner_points = all_corners(find, map_cache, longest, source.corners.model_dump_json())
    views = MapViews(source)
    with progress_bar(f"{source.name} map features", len(images)) as advance:
        for done, (image, corners) in enumerate(zip(images, corner_points, strict=True), 1):
            points = np.concatenate([_reliable_points(image, map_cache.sparse_map), corners])
            view_key = views.key(image)
            key = digest_of(_FORMAT, view_key, image.cam_from_world, points, source.points)
            arrays = read_earlier(key, source.array_names)
            if arrays is None or (observer is not None and observer.needs(image, view_key)):
                view, maps = views(image)
                if observer is not None:
                    observer(image, view_key, view, maps)
                seen = observe(view, maps, image.pose, points, source.points)
                found: list[NDArray[Any]] = [seen.xyz, seen.confidence, *seen.features]
                arrays = dict(zip(source.array_names, found, strict=True))
                del view, maps
                trim_heap()
            yield key, arrays
            advance(done)


class MapViews:
    """Warps photographs of a map north up to the map's resolution, and extracts feature maps."""

    def __init__(self, source: ReferenceSource) -> None:
        self._source = source

    def __call__(self, image: MapImage) -> tuple[WarpedImage, list[FeatureMap]]:
        """Return the warped photograph and its feature maps.

        Raises:
            InputError: the photograph is missing, broken or not of its camera's size.
        """
        rgb = read_rgb(self._source.map_cache.images / image.name, image.camera)
        return self._source.extract(rgb, image.camera, *self._rotation_and_scale(image))

    def key(self, image: MapImage) -> str:
        """Return a digest of all inputs of a photograph's feature maps."""
        source, warp = self._source, self._rotation_and_scale(image)
        return digest_of(
            source.map_cache.digests[image.name], image.camera, *warp, source.extractor_key
        )

    def _rotation_and_scale(self, image: MapImage) -> tuple[float, float]:
        """Return the rotation (rad) and the scale of a photograph's warp."""
        source = self._source
        resolution = metres_per_pixel(
            image.pose, image.camera, observed_xyz(image, source.map_cache.sparse_map)
        )
        largest = source.extract.largest_scale(image.camera)
        scale = scale_to(source.target_resolution, resolution, largest)
        return north_angle(image.cam_from_world[:3, :3]), scale


def observe(
    view: WarpedImage,
    maps: list[FeatureMap],
    pose: Pose,
    xyz: NDArray[np.float64],
    count: int,
) -> Observations:
    """Return the features of at most ``count`` points that are in view of a photograph.

    Features are sampled where the points project, as in PixLoc, not at the keypoints that observed
    them. Of the points in one cell of ``order_by_coverage``, the one with the highest confidence
    comes first.

    Args:
        view: the warped photograph.
        maps: feature maps of the view.
        pose: ``cam_from_world`` of the photograph.
        xyz: (M, 3) points, world metres.
        count: maximum number of points.
    """
    projected = view.camera.project(view.pose(pose).transform(torch.from_numpy(xyz)))
    inside = (projected.valid & view.camera.contains(projected.xy)).numpy()
    levels = [level.sample(projected.xy.float()) for level in maps]
    confidence = torch.stack([c for _, c in levels], -1)
    seen = np.flatnonzero(inside & (confidence > 0).all(-1).cpu().numpy())
    size = np.array([view.camera.width, view.camera.height])
    worth = confidence.log().sum(-1).cpu().numpy()[seen]
    kept = seen[order_by_coverage(projected.xy.numpy()[seen] / size, worth)[:count]]
    return Observations(
        xyz[kept],
        tuple(features[kept].to(torch.float16).cpu().numpy() for features, _ in levels),
        confidence[kept].to(torch.float16).cpu().numpy(),
    )


def _reliable_points(image: MapImage, sparse_map: SparseMap) -> NDArray[np.float64]:
    """Return the points (N, 3) with long tracks in a photograph, or all if these are few."""
    rows = np.unique(image.point_rows[image.point_rows >= 0])
    reliable = rows[sparse_map.track_length[rows] >= _MIN_TRACK]
    return np.asarray(sparse_map.xyz[reliable if len(reliable) >= _MIN_POINTS else rows])


def order_by_coverage(
    xy: NDArray[np.float64], worth: NDArray[Any], grid: int = GRID
) -> NDArray[np.int64]:
    """Return the order of points (N,) in which the first n cover the picture, for every n.

    The best point of every cell of a grid comes first, then the second best of every cell, and so
    on.

    Args:
        xy: (N, 2) positions as shares of the picture's width and height, 0 to 1.
        worth: (N,) scores; larger ones come first in a cell.
        grid: cells along each side of the picture.

    Examples:
        >>> xy = np.array([[0.1, 0.1], [0.2, 0.2], [0.9, 0.9]])
        >>> order_by_coverage(xy, np.array([1, 3, 2]), grid=2).tolist()
        [1, 2, 0]
    """
    by_worth = np.argsort(-worth, kind="stable")
    column, row = np.clip((xy[by_worth] * grid).astype(int), 0, grid - 1).T
    cell = row * grid + column
    by_cell = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[by_cell], cell)
    rank = np.empty(len(cell), np.int64)
    rank[by_cell] = np.arange(len(cell))
    return by_worth[np.argsort(rank - first, kind="stable")]
