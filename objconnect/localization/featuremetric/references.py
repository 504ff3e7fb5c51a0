"""Features of a map's points in its photographs, computed once and kept on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Final, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.localization.cache.map_cache import Earlier, MapCache
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
from objconnect.scene.storage.lru_cache import LruCache, room

_FORMAT: Final = 6
# Points seen by fewer photographs are left out, as by PixLoc's authors.
_MIN_TRACK: Final = 3
# Photographs with fewer reliable points keep all their points.
_MIN_POINTS: Final = 64
POINTS: Final = 2048
"""Maximum number of points of a photograph, and of all reference images of a query together."""
GRID: Final = 16
"""Cells along each side of the grid that spreads points over a picture."""


class FeatureObserver(Protocol):
    """Observes feature maps of a map's photographs while these are computed."""

    def lacks(self, image: MapImage, key: str) -> bool:
        """Return whether it needs a photograph; ``key`` is that of ``MapViews``."""
        ...

    def __call__(
        self, image: MapImage, key: str, view: WarpedImage, maps: list[FeatureMap]
    ) -> None:
        """Receive the feature maps of a photograph."""
        ...

    def write(self) -> None:
        """Write the results to a file of the cache."""
        ...


@dataclass(frozen=True)
class ReferenceSource:
    """The inputs of the observations of a map's photographs.

    Attributes:
        kept: the map, its photographs and the cache.
        extractor_key: identifies the network's weights and its options, for the cache.
        name: name of the method, for files and progress.
        points: maximum number of points of a photograph.
        corners: options of corners that become points; None for no corners.
    """

    kept: MapCache
    extract: MapExtractor
    extractor_key: str
    name: str
    points: int = POINTS
    corners: CornerOptions | None = None

    @property
    def identity(self) -> tuple[object, ...]:
        """Return the inputs of the cache key beside the map and its photographs."""
        corners = self.corners and self.corners.model_dump_json()
        return _FORMAT, self.points, corners, self.extractor_key

    @property
    def arrays(self) -> list[str]:
        """Return the names of the arrays of a photograph."""
        levels = range(len(self.extract.network.config.strides))
        return ["xyz", "confidence", *(f"features {level}" for level in levels)]

    @cached_property
    def metres_per_pixel(self) -> float:
        """Return the ground resolution of the map, to which photographs are resized; NaN if
        unknown."""
        return map_resolution(self.kept.sparse_map, self.extract.largest_scale)


@dataclass(frozen=True)
class Observations:
    """N points of the map with their features in one photograph.

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
        """Return the bytes of all arrays."""
        return self.xyz.nbytes + self.confidence.nbytes + sum(f.nbytes for f in self.features)


class ReferenceFeatures:
    """Observations of all photographs of a map, in a file with a least-recently-used cache.

    Threads may share it.

    Args:
        store: the file.
        names: names of the arrays of a photograph.
        metres_per_pixel: ground resolution of the resized photographs; NaN if unknown.
        memory: bound of the cache, bytes.
    """

    def __init__(
        self, store: Store, names: Sequence[str], metres_per_pixel: float, memory: int
    ) -> None:
        self._store, self.metres_per_pixel = store, metres_per_pixel
        self._cache = LruCache(partial(_read, store, names), memory)

    def __len__(self) -> int:
        return len(self._store)

    def __getitem__(self, photograph: int) -> Observations:
        """Return the observations of a photograph, given its row in ``SparseMap.names``."""
        return self._cache(photograph)

    def coarse(self, photograph: int) -> NDArray[np.float32]:
        """Read the features (N, C) of a photograph's coarsest level, without the cache."""
        return self._store.read(photograph, "features 0").astype(np.float32)


def _read(store: Store, names: Sequence[str], photograph: int) -> Observations:
    xyz, confidence, *features = store.arrays(photograph, names).values()
    return Observations(xyz, tuple(features), confidence)


def load_references(
    source: ReferenceSource, memory_mb: int, watch: FeatureObserver | None = None
) -> ReferenceFeatures:
    """Return the observations of a map's photographs, computed unless the cache holds them.

    Args:
        source: their inputs.
        memory_mb: memory of the whole process; observations stay in memory as far as there is room.
        watch: observes the feature maps that are computed.

    Raises:
        InputError: a photograph is broken or changed meanwhile.
    """
    store = source.kept.store(
        source.name, *source.identity, rows=partial(_compute_rows, source, watch)
    )
    return ReferenceFeatures(store, source.arrays, source.metres_per_pixel, room(memory_mb))


def write_part(source: ReferenceSource, watch: FeatureObserver | None) -> None:
    """Compute the observations of a part of a map's photographs, unless the cache holds all.

    The arguments and errors are those of ``load_references``, which copies what this has written.
    """
    if not source.kept.holds(source.name, *source.identity):
        load_references(source, 0, watch)
        if watch is not None:
            watch.write()


def _compute_rows(source: ReferenceSource, watch: FeatureObserver | None, earlier: Earlier) -> Rows:
    """Run the network on photographs of a map and yield the features at their points."""
    kept = source.kept
    posed = [kept.sparse_map.images[name] for name in kept.names]
    corner_points = [np.empty((0, 3))] * len(posed)
    if source.corners is not None:
        longest = source.extract.longest
        find = CornerFinder(kept.sparse_map, kept.images, longest, source.corners)
        corner_points = all_corners(find, kept, longest, source.corners.model_dump_json())
    views = MapViews(source)
    with progress_bar(f"{source.name} map features", len(posed)) as advance:
        for done, (image, corners) in enumerate(zip(posed, corner_points, strict=True), 1):
            points = np.concatenate([_reliable_points(image, kept.sparse_map), corners])
            seen_as = views.key(image)
            key = digest_of(_FORMAT, seen_as, image.cam_from_world, points, source.points)
            arrays = earlier(key, source.arrays)
            if arrays is None or (watch is not None and watch.lacks(image, seen_as)):
                view, maps = views(image)
                if watch is not None:
                    watch(image, seen_as, view, maps)
                seen = observe(view, maps, image.pose, points, source.points)
                found: list[NDArray[Any]] = [seen.xyz, seen.confidence, *seen.features]
                arrays = dict(zip(source.arrays, found, strict=True))
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
        rgb = read_rgb(self._source.kept.images / image.name, image.camera)
        return self._source.extract(rgb, image.camera, *self._rotation_and_scale(image))

    def key(self, image: MapImage) -> str:
        """Return a digest of all inputs of a photograph's feature maps."""
        source, how = self._source, self._rotation_and_scale(image)
        return digest_of(source.kept.digests[image.name], image.camera, *how, source.extractor_key)

    def _rotation_and_scale(self, image: MapImage) -> tuple[float, float]:
        """Return the rotation (rad) and the scale of a photograph's warp."""
        source = self._source
        own = metres_per_pixel(
            image.pose, image.camera, observed_xyz(image, source.kept.sparse_map)
        )
        largest = source.extract.largest_scale(image.camera)
        scale = scale_to(source.metres_per_pixel, own, largest)
        return north_angle(image.cam_from_world[:3, :3]), scale


def observe(
    view: WarpedImage,
    maps: list[FeatureMap],
    pose: Pose,
    xyz: NDArray[np.float64],
    points: int,
) -> Observations:
    """Return the features of points in a photograph, at most ``points`` of those in view.

    Features are sampled where the points project, as in PixLoc, not where they were observed. Among
    neighbours, the point with the highest confidence comes first.

    Args:
        view: the warped photograph.
        maps: feature maps of the view.
        pose: ``cam_from_world`` of the photograph.
        xyz: (M, 3) points, world metres.
        points: maximum number of points.
    """
    projected = view.camera.project(view.pose(pose).transform(torch.from_numpy(xyz)))
    inside = (projected.valid & view.camera.contains(projected.xy)).numpy()
    levels = [level.sample(projected.xy.float()) for level in maps]
    confidence = torch.stack([c for _, c in levels], -1)
    seen = np.flatnonzero(inside & (confidence > 0).all(-1).cpu().numpy())
    size = np.array([view.camera.width, view.camera.height])
    worth = confidence.log().sum(-1).cpu().numpy()[seen]
    kept = seen[order_by_coverage(projected.xy.numpy()[seen] / size, worth)[:points]]
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
    """Order points so that any first few of them cover the picture.

    The best point of every cell of a grid comes first, then the second best of every cell, and so
    on.

    Args:
        xy: (N, 2) in 0..1.
        worth: (N,) scores; larger ones come first in a cell.
        grid: cells along each side of the picture.

    Example:
        >>> xy = np.array([[0.1, 0.1], [0.2, 0.2], [0.9, 0.9]])
        >>> order_by_coverage(xy, np.array([1, 3, 2]), grid=2).tolist()
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
