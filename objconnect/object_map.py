"""Objects of photographs and of maps, found by a network with a detector."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from baselines.featuremetric.maps import MapExtractor
from baselines.map_cache import MapCache
from baselines.place.grid import GroundGrid, ground_grid
from baselines.views import looks_down
from objconnect.detector import Detections, DetectorMaps, ObjectDetector, detections
from objconnect.landmarks import LandmarkOptions, Landmarks, View, merged, on_ground
from scene.geometry.camera import Camera
from scene.maps.sparse_map import SparseMap
from scene.runtime.memory import return_freed
from scene.runtime.progress import progress_bar
from scene.storage.images import read_rgb

_FORMAT: Final = 1
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

    @torch.inference_mode()
    def __call__(self, rgb: NDArray[np.uint8], camera: Camera) -> Detections:
        """Return the objects of a photograph (H, W, 3), in its own pixels."""
        view, levels = self._extract(rgb, camera)
        found = self.detect(
            view.picture, self._detector([(level.features, level.confidence) for level in levels])
        )
        xy = torch.from_numpy(view.in_photograph(found.xy.double().numpy()))
        inside = view.shows(found.xy.double().numpy())
        kept = torch.from_numpy(inside)
        return Detections(
            xy[kept],
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
        ground = map_ground(sparse_map)
        views = []
        with progress_bar("objects of the map", len(sparse_map.names)) as advance:
            for done, name in enumerate(sparse_map.names, 1):
                image = sparse_map.images[name]
                if looks_down(image.cam_from_world[:3, :3]):
                    found = self(read_rgb(images / name, image.camera), image.camera)
                    placed = on_ground(found, image.camera, image.pose, ground)
                    views.append(View(name, image.camera, image.pose, found, placed))
                    return_freed()
                advance(done)
        return views

    def kept_landmarks(
        self, sparse_map: SparseMap, images: Path, key: str, cache: Path
    ) -> Landmarks:
        """Return the objects of a map, from the cache where it holds them.

        Args:
            sparse_map: the map.
            images: folder that the names of its photographs are relative to.
            key: of the network.
            cache: folder of files named by a digest of all that the objects depend on.

        Raises:
            InputError: a photograph is missing, broken or changed meanwhile.
        """
        kept = MapCache.of(sparse_map, images, cache)
        path = kept.path("objects", _FORMAT, key, self._options.model_dump_json())
        if not path.is_file():
            landmarks = self.landmarks(sparse_map, images)
            kept.require_unchanged()
            landmarks.write(path)
        return Landmarks.read(path)


def map_ground(sparse_map: SparseMap) -> GroundGrid:
    """Return the height of a map's ground on a grid, without what stands on it.

    What is narrower than the window of a morphological opening is taken away.
    """
    grid = ground_grid(sparse_map.xyz, _GROUND_M)
    cells = max(1, round(_WIDEST_M / _GROUND_M))
    bare = cv2.morphologyEx(grid.heights, cv2.MORPH_OPEN, np.ones((cells, cells), np.uint8))
    return replace(grid, heights=np.asarray(bare))
