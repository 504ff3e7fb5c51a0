"""Detection of the objects of photographs, and of the landmarks, the objects of a map."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.localization.cache.map_cache import EarlierRows, MapCache, open_cache
from objconnect.localization.cache.store import Rows
from objconnect.localization.coarse.grid import GroundGrid, ground_grid
from objconnect.localization.featuremetric.maps import FeatureMap, MapExtractor
from objconnect.localization.featuremetric.references import MapViews, ReferenceSource
from objconnect.network.detector import Detections, DetectorMaps, ObjectDetector, extract_detections
from objconnect.network.landmarks import (
    LEAST_SCORE,
    MAX_OBJECTS,
    Landmarks,
    View,
    merge,
    place_on_ground,
)
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.views import WarpedImage, looks_down
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.runtime.tuning import trim_heap
from objconnect.scene.storage.digests import digest_of

_FORMAT: Final = 4
# Name of cache files with the landmarks of a map.
_OBJECTS: Final = "objects"
# Name of cache files with the objects of each photograph, and the arrays in them.
_DETECTIONS: Final = "detections"
_ARRAYS: Final = ("xy", "score", "side", "rise", "vectors")
# Side of the cells of the grid of the ground's heights, metres.
_GROUND_M: Final = 4.0
# Things on the ground up to this width, metres, are removed from the heights of the ground.
_MAX_REMOVED_M: Final = 28.0


class ObjectFinder:
    """Finds the objects of photographs."""

    def __init__(self, extract: MapExtractor, detector: ObjectDetector) -> None:
        self._extract, self._detector = extract, detector

    def __call__(self, rgb: NDArray[np.uint8], camera: Camera) -> Detections:
        """Return the objects of a photograph (H, W, 3), in pixels of the photograph."""
        return self.find_in_view(*self._extract(rgb, camera))

    @torch.inference_mode()
    def find_in_view(self, view: WarpedImage, levels: Sequence[FeatureMap]) -> Detections:
        """Return the objects of a view, in pixels of its photograph.

        Args:
            view: the warped photograph.
            levels: feature maps of the view, coarse to fine.
        """
        found = self.detect(self._detector([(each.features, each.confidence) for each in levels]))
        xy = found.xy.double().numpy()
        kept = torch.from_numpy(view.shows(xy))
        return Detections(
            torch.from_numpy(view.in_photograph(xy))[kept],
            found.score[kept],
            found.side[kept] / view.scale,
            found.rise[kept] / view.scale,
            found.vectors[kept],
        )

    def detect(self, maps: DetectorMaps) -> Detections:
        """Return the objects in the maps of the detector, on the CPU."""
        stride = self._detector.config.stride
        return extract_detections(maps, stride, MAX_OBJECTS, LEAST_SCORE).cpu()

    def landmarks(self, sparse_map: SparseMap, images: Path) -> Landmarks:
        """Return the landmarks in the photographs of a map that look down.

        Raises:
            InputError: a photograph is missing or broken.
        """
        with open_cache(sparse_map, images, None) as map_cache:
            return merge(self.views(map_cache))[0]

    def views(self, map_cache: MapCache) -> list[View]:
        """Return the photographs of a map that look down, each with its objects.

        Raises:
            InputError: a photograph is broken.
        """
        return list(MapObjects(self, ReferenceSource(map_cache, self._extract, "", "", 0)).views())

    def observer(self, source: ReferenceSource) -> MapObjects | None:
        """Return an observer that finds objects in the feature maps of a map's photographs.

        It is None if the cache holds the landmarks.
        """
        is_known = source.map_cache.holds(_OBJECTS, *self._landmarks_key(source))
        return None if is_known else MapObjects(self, source)

    def load_landmarks(self, source: ReferenceSource, observer: MapObjects | None) -> Landmarks:
        """Return the landmarks of a map, computed unless the cache holds them.

        Raises:
            InputError: a photograph is broken or changed meanwhile.
        """

        def rows(_: EarlierRows) -> Rows:
            map_objects = observer or MapObjects(self, source)
            landmarks = merge(list(map_objects.views()))[0]
            map_objects.write()
            yield "", landmarks.arrays()

        store = source.map_cache.store(_OBJECTS, *self._landmarks_key(source), rows=rows)
        return store.make(0, Landmarks.ARRAYS, Landmarks.of)

    def _landmarks_key(self, source: ReferenceSource) -> tuple[object, ...]:
        """Return the parts of the cache key in addition to the map and its photographs."""
        return _FORMAT, source.extractor_key


class MapObjects:
    """Finds the objects of the photographs of a map that look down.

    It implements ``FeatureObserver``, so that the feature maps of a photograph are computed once
    for both its reference features and its objects.
    """

    def __init__(self, find: ObjectFinder, source: ReferenceSource) -> None:
        self._find, self._source = find, source
        self._read_earlier = source.map_cache.earlier(_DETECTIONS)
        self._map_views = MapViews(source)
        self._found: dict[str, Detections] = {}

    def needs(self, image: MapImage, key: str) -> bool:
        """Return whether a photograph looks down and its objects are unknown."""
        if not looks_down(image.cam_from_world[:3, :3]):
            return False
        if image.name not in self._found:
            found = self._read_earlier(digest_of(key, _FORMAT), _ARRAYS)
            if found is not None:
                self._found[image.name] = Detections(*map(torch.from_numpy, found.values()))
        return image.name not in self._found

    def __call__(
        self, image: MapImage, key: str, view: WarpedImage, maps: list[FeatureMap]
    ) -> None:
        """Find the objects of a photograph from its view and feature maps."""
        if self.needs(image, key):
            self._found[image.name] = self._find.find_in_view(view, maps)

    def views(self) -> Iterator[View]:
        """Yield the photographs that look down, each with its objects.

        Objects that neither ``__call__`` nor the cache gave are computed.

        Raises:
            InputError: a photograph is missing or broken.
        """
        ground, images = map_ground(self._source.map_cache.sparse_map), self._images_from_above()
        with progress_bar("objects of the map", len(images)) as advance:
            for done, image in enumerate(images, 1):
                key = self._map_views.key(image)
                if self.needs(image, key):
                    self(image, key, *self._map_views(image))
                    trim_heap()
                found = self._found[image.name]
                placed = place_on_ground(found, image.camera, image.pose, ground)
                yield View(image.name, image.camera, image.pose, found, placed)
                advance(done)

    def write(self) -> None:
        """Write the objects of each photograph to the cache.

        A later map with added photographs then computes only the objects of the added ones.

        Raises:
            InputError: a photograph changed meanwhile.
            WriteError: the folder cannot be written, or the disk is full.
        """

        def rows(_: EarlierRows) -> Rows:
            for image in self._images_from_above():
                found = self._found[image.name]
                arrays = {name: getattr(found, name).numpy() for name in _ARRAYS}
                yield digest_of(self._map_views.key(image), _FORMAT), arrays

        map_cache, extractor_key = self._source.map_cache, self._source.extractor_key
        map_cache.store(_DETECTIONS, _FORMAT, extractor_key, rows=rows)

    def _images_from_above(self) -> list[MapImage]:
        """Return the photographs that look down, in the order of their names."""
        map_cache = self._source.map_cache
        images = [map_cache.sparse_map.images[name] for name in map_cache.names]
        return [image for image in images if looks_down(image.cam_from_world[:3, :3])]


def map_ground(sparse_map: SparseMap) -> GroundGrid:
    """Return the heights of a map's ground on a grid, without things that stand on it.

    A morphological opening removes things narrower than its window.
    """
    grid = ground_grid(sparse_map.xyz, _GROUND_M)
    cells = max(1, round(_MAX_REMOVED_M / _GROUND_M))
    ground = cv2.morphologyEx(grid.heights, cv2.MORPH_OPEN, np.ones((cells, cells), np.uint8))
    return replace(grid, heights=np.asarray(ground))
