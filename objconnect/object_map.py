"""Objects of photographs and of maps, found by a network with a detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from baselines.featuremetric.maps import FeatureMap, MapExtractor
from baselines.featuremetric.references import ReferenceSource, photograph_maps
from baselines.map_cache import MapCache
from baselines.place.grid import GroundGrid, ground_grid
from baselines.views import WarpedImage, looks_down
from objconnect.detector import Detections, DetectorMaps, ObjectDetector, detections
from objconnect.landmarks import LandmarkOptions, Landmarks, View, merged, on_ground
from scene.geometry.camera import Camera
from scene.maps.sparse_map import MapImage, SparseMap
from scene.runtime.memory import return_freed
from scene.runtime.progress import progress_bar

_FORMAT: Final = 2
# Side of the cells in which the height of the ground is the median of the map's points, metres.
_GROUND_M: Final = 4.0
# What stands on the ground is narrower, metres.
_WIDEST_M: Final = 28.0


class ObjectFinder:
    """Finds the objects of photographs.

    Args:
        extract: of the feature maps that the detector sees.
        detector: of objects.
        options: of the objects that are kept.
    """

    def __init__(
        self, extract: MapExtractor, detector: ObjectDetector, options: LandmarkOptions
    ) -> None:
        self._extract, self._detector, self._options = extract, detector, options

    def __call__(self, rgb: NDArray[np.uint8], camera: Camera) -> Detections:
        """Return the objects of a photograph (H, W, 3), in its own pixels."""
        return self.of(*self._extract(rgb, camera))

    @torch.inference_mode()
    def of(self, view: WarpedImage, levels: Sequence[FeatureMap]) -> Detections:
        """Return the objects of a view in pixels of its photograph, given its feature maps."""
        found = self.detect(
            view.picture, self._detector([(level.features, level.confidence) for level in levels])
        )
        at = found.xy.double().numpy()
        kept = torch.from_numpy(view.shows(at))
        return Detections(
            torch.from_numpy(view.in_photograph(at))[kept],
            found.score[kept],
            found.side[kept] / view.scale,
            found.rise[kept] / view.scale,
            found.vectors[kept],
        )

    def detect(self, picture: NDArray[np.uint8], maps: DetectorMaps) -> Detections:
        """Return the objects of a picture (H, W, 3), given what the detector says of it."""
        options, stride = self._options, self._detector.config.stride
        return detections(maps, stride, options.count, options.least_score)

    def landmarks(self, sparse_map: SparseMap, images: Path) -> Landmarks:
        """Return the objects that the photographs of a map show from above.

        Raises:
            InputError: a photograph is missing or broken.
        """
        return merged(self.views(sparse_map, images), self._options)[0]

    def views(self, sparse_map: SparseMap, images: Path) -> list[View]:
        """Return the photographs of a map that look down, each with its objects.

        Raises:
            InputError: a photograph is missing or broken.
        """
        return self.views_in(ReferenceSource(sparse_map, images, self._extract, "", "objects", 0))

    def views_in(self, source: ReferenceSource) -> list[View]:
        """Return what ``views`` does, of the photographs that references are computed from."""
        collect = ViewCollector(self, source.sparse_map)
        images = source.sparse_map.images
        down = [
            images[name]
            for name in source.sparse_map.names
            if looks_down(images[name].cam_from_world[:3, :3])
        ]
        with progress_bar("objects of the map", len(down)) as advance:
            for done, each in enumerate(photograph_maps(source, down), 1):
                collect(*each)
                return_freed()
                advance(done)
        return collect.views

    def file(self, source: ReferenceSource, cache: Path) -> Path:
        """Return where the cache holds the objects of a map, whether or not it does."""
        kept = MapCache.of(source.sparse_map, source.images, cache)
        seen = f"{source.extractor_key} {source.options.same_resolution}"
        return kept.path("objects", _FORMAT, seen, self._options.model_dump_json())

    def kept_landmarks(
        self, source: ReferenceSource, cache: Path, collected: ViewCollector | None
    ) -> Landmarks:
        """Return the objects of a map, from the cache where it holds them.

        Args:
            source: what references of the map are computed from.
            cache: folder of files named by a digest of all that the objects depend on.
            collected: has seen the photographs already; None where nothing has.

        Raises:
            InputError: a photograph is missing, broken or changed meanwhile.
        """
        path = self.file(source, cache)
        if not path.is_file():
            whole = collected is not None and collected.seen == len(source.sparse_map.names)
            views = collected.views if collected and whole else self.views_in(source)
            landmarks = merged(views, self._options)[0]
            MapCache.of(source.sparse_map, source.images, cache).require_unchanged()
            landmarks.write(path)
        return Landmarks.read(path)


class ViewCollector:
    """Collects the objects of a map's photographs while these are looked at.

    Args:
        find: finds the objects of a view.
        sparse_map: the map.

    Attributes:
        views: the photographs that look down, each with its objects.
        seen: number of photographs that were looked at.
    """

    def __init__(self, find: ObjectFinder, sparse_map: SparseMap) -> None:
        self._find, self._ground = find, map_ground(sparse_map)
        self.views: list[View] = []
        self.seen = 0

    def __call__(self, image: MapImage, view: WarpedImage, levels: list[FeatureMap]) -> None:
        """Find the objects of a photograph, given how it was seen and its feature maps."""
        self.seen += 1
        if looks_down(image.cam_from_world[:3, :3]):
            found = self._find.of(view, levels)
            placed = on_ground(found, image.camera, image.pose, self._ground)
            self.views.append(View(image.name, image.camera, image.pose, found, placed))


def map_ground(sparse_map: SparseMap) -> GroundGrid:
    """Return the height of a map's ground on a grid, without what stands on it.

    What is narrower than the window of a morphological opening is taken away.
    """
    grid = ground_grid(sparse_map.xyz, _GROUND_M)
    cells = max(1, round(_WIDEST_M / _GROUND_M))
    bare = cv2.morphologyEx(grid.heights, cv2.MORPH_OPEN, np.ones((cells, cells), np.uint8))
    return replace(grid, heights=np.asarray(bare))
