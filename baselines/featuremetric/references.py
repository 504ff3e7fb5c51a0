"""What the points of a map look like in its photographs: computed once, kept on disk.

Only features at points are needed of the photographs, and these are few.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.array_store import ArrayStore, written_store
from baselines.featuremetric.corners import all_corners
from baselines.featuremetric.maps import FeatureMap, MapExtractor
from baselines.resolution import metres_per_pixel, observed, of_map, scale_to
from baselines.views import View, north
from scene.geometry.pose import Pose
from scene.maps.sparse_map import MapImage, SparseMap
from scene.runtime.progress import progress_bar
from scene.storage.digests import digests, require_unchanged
from scene.storage.images import check_photographs, read_rgb
from scene.storage.lru_cache import LruCache, room

# Points seen by fewer photographs are less sure; PixLoc's authors leave them out.
_LEAST_TRACK: Final = 3
# Unless a photograph has fewer of the others than this.
_LEAST_POINTS: Final = 64
# Points are taken in turns from the cells of a grid of so many by so many over the photograph.
_GRID: Final = 16
_FORMAT: Final = 3


@dataclass(frozen=True)
class Observations:
    """Points of the map as one photograph shows them, N in all.

    They stand in the order in which to take fewer of them: spread over the photograph.

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
        path: written by ``write_references``.
        memory: bytes that observations in memory may take.

    Attributes:
        metres_per_pixel: at which the photographs were seen, NaN if not known.
    """

    def __init__(self, path: Path, memory: int) -> None:
        self._shelf = ArrayStore(path)
        levels = range(int(self._shelf.attribute("levels")))
        names = ("xyz", "confidence", *(f"features/{level}" for level in levels))
        self._held = LruCache(partial(_read, self._shelf, names), memory)
        self.metres_per_pixel = float(self._shelf.attribute("metres_per_pixel"))

    def __len__(self) -> int:
        return len(self._shelf)

    def __getitem__(self, photograph: int) -> Observations:
        """Of a photograph by its row in ``SparseMap.names``."""
        return self._held(photograph)

    def coarse(self, photograph: int) -> NDArray[np.float32]:
        """The features of a photograph's coarsest level alone, (N, C), which are not kept."""
        return self._shelf.read(photograph, "features/0").astype(np.float32)


def _read(shelf: ArrayStore, names: Sequence[str], photograph: int) -> Observations:
    xyz, confidence, *features = (shelf.read(photograph, name) for name in names)
    return Observations(xyz, tuple(features), confidence)


def references(
    sparse_map: SparseMap,
    images: Path,
    extract: MapExtractor,
    points: int,
    corners: int,
    name: str,
    key: str,
    cache: Path,
    memory_mb: int,
) -> ReferenceFeatures:
    """Observations of a map's photographs, from the cache where it holds them.

    Args:
        sparse_map: whose points and photographs.
        images: folder of the photographs.
        extract: of feature maps.
        points: most to keep per photograph.
        corners: of a photograph to place beside the points of the map; 0 for none.
        name: of the method, to call files and progress by.
        key: of everything else that decides the features: weights and options.
        cache: folder of files named by a digest of all of it.
        memory_mb: for the whole process; observations stay in memory as far as there is room.

    Raises:
        InputError: a photograph is missing, broken, not of its camera's size, or changed meanwhile.
    """
    check_photographs(images, {name: sparse_map.images[name].camera for name in sparse_map.names})
    files = [images / name for name in sparse_map.names]
    photographs = digests(files)
    check = partial(require_unchanged, files, photographs)

    def file(of: str, *parts: object) -> Path:
        words = " ".join(map(str, (_FORMAT, sparse_map.sha256, photographs, *parts)))
        return cache / f"{of}-{hashlib.sha256(words.encode()).hexdigest()[:16]}.h5"

    path = file(name, points, corners, key)
    if not path.is_file():
        beside = [np.empty((0, 3))] * len(sparse_map.names)
        if corners:
            kept = file("corners", corners, extract.longest)
            beside = all_corners(sparse_map, images, corners, extract.longest, kept, check)
        write_references(path, sparse_map, images, extract, points, beside, name, check)
    return ReferenceFeatures(path, room(memory_mb))


def write_references(
    path: Path,
    sparse_map: SparseMap,
    images: Path,
    extract: MapExtractor,
    points: int,
    beside: Sequence[NDArray[np.float64]],
    name: str,
    check: Callable[[], None],
) -> None:
    """Run the network on every photograph of a map and keep what its points look like.

    ``beside`` are further points (N, 3) of each photograph. Where ``check`` raises at the end,
    nothing is kept.
    """
    posed = [sparse_map.images[each] for each in sparse_map.names]
    wanted = of_map(sparse_map, lambda camera: min(1.0, extract.largest_scale(camera)))
    levels = len(extract.network.config.strides)
    with (
        written_store(path, levels=levels, metres_per_pixel=wanted) as add,
        progress_bar(f"{name} map features", len(posed)) as advance,
    ):
        for done, (image, further) in enumerate(zip(posed, beside, strict=True), 1):
            rgb = read_rgb(images / image.name, image.camera)
            own = metres_per_pixel(image.pose, image.camera, observed(image, sparse_map))
            scale = scale_to(wanted, own, extract.largest_scale(image.camera))
            looked = extract(rgb, image.camera, north(image.cam_from_world[:3, :3]), scale)
            placed = np.concatenate([_sure(image, sparse_map), further])
            seen = observe(*looked, image.pose, placed, points)
            features = {f"features/{level}": of for level, of in enumerate(seen.features)}
            add({"xyz": seen.xyz, "confidence": seen.confidence, **features})
            advance(done)
        check()


def observe(
    view: View, maps: list[FeatureMap], pose: Pose, xyz: NDArray[np.float64], points: int
) -> Observations:
    """What points look like in a view of a photograph, at most ``points`` of those it shows.

    Features are taken where the points project, as PixLoc's authors do, not where they were
    observed. Of neighbours the one comes first of which the network is surest.

    Args:
        view: of the photograph.
        maps: its levels.
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


def _sure(image: MapImage, sparse_map: SparseMap) -> NDArray[np.float64]:
    """Points of the map that a photograph observes, (N, 3); the sure ones where they suffice."""
    rows = np.unique(image.point_rows[image.point_rows >= 0])
    sure = rows[sparse_map.track_length[rows] >= _LEAST_TRACK]
    return np.asarray(sparse_map.xyz[sure if len(sure) >= _LEAST_POINTS else rows])


def spaced_order(xy: NDArray[np.float64], worth: NDArray[Any]) -> NDArray[np.int64]:
    """An order of points of which every beginning covers the picture: the worthiest of every cell
    of a grid, then the second of every cell, and so on.

    Args:
        xy: (N, 2) in 0..1.
        worth: (N,).
    """
    by_worth = np.argsort(-worth, kind="stable")
    column, row = np.clip((xy[by_worth] * _GRID).astype(int), 0, _GRID - 1).T
    cell = row * _GRID + column
    by_cell = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[by_cell], cell)
    place = np.empty(len(cell), np.int64)
    place[by_cell] = np.arange(len(cell))
    return by_worth[np.argsort(place - first, kind="stable")]
