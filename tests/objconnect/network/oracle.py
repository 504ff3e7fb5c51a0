"""Detections of objects whose positions are known, as a perfect network would find them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from objconnect.mapping.supplement.config import SupplementConfig
from objconnect.mapping.supplement.triangulation import (
    Detections,
    TriangulatedPoint,
    triangulate,
)
from objconnect.scene.bundle.manifest import SceneObject
from objconnect.scene.bundle.scene import Scene

DIMENSIONS = 32


@dataclass(frozen=True)
class Detected:
    """Detections of known objects.

    Attributes:
        detections: detections by photograph.
        tracks: rows of the detections of each object, by photograph.
    """

    detections: dict[str, Detections]
    tracks: list[dict[str, int]]

    def triangulate(
        self, scene: Scene, config: SupplementConfig | None = None
    ) -> list[TriangulatedPoint]:
        """Triangulate each object that enough photographs show."""
        sparse_map, options = scene.sparse_map(), config or SupplementConfig()
        points = [triangulate(sparse_map, self.detections, rows, options) for rows in self.tracks]
        return [point for point in points if point is not None]


def detect_known(
    scene: Scene,
    wanted: Callable[[SceneObject], bool] = lambda item: item.size_class == "small",
    noise_px: float = 0.0,
    seed: int = 0,
) -> Detected:
    """Detect the centres of objects where a photograph of the map shows them unhidden.

    Args:
        scene: rendered, with its map.
        wanted: objects to detect.
        noise_px: standard deviation of the pixels.
        seed: random seed of noise, descriptors and confidence.
    """
    rng = np.random.default_rng(seed)
    items = [item for item in scene.objects.objects if wanted(item)]
    centres = torch.tensor([item.centre for item in items], dtype=torch.float64)
    found, tracks = {}, defaultdict(dict)
    for image, layers in scene.layers_of_map(scene.sparse_map(), "instance"):
        seen = image.camera.project(image.pose.transform(centres))
        inside = (seen.valid & image.camera.contains(seen.xy, 1)).numpy()
        xy = []
        for k in np.flatnonzero(inside):
            column, row = seen.xy[k].numpy().astype(int)
            if layers["instance"][row, column] == items[k].id:
                tracks[items[k].id][image.name] = len(xy)
                xy.append(seen.xy[k].numpy())
        noisy = np.array(xy).reshape(-1, 2) + rng.normal(scale=noise_px, size=(len(xy), 2))
        vectors = rng.normal(size=(len(xy), DIMENSIONS))
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
        confidence = rng.uniform(0.5, 1, len(noisy))
        found[image.name] = Detections(noisy, vectors.astype(np.float32), confidence)
    return Detected(found, list(tracks.values()))
