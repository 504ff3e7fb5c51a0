"""Measure distances of map points from the true surfaces of rendered scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.scene.bundle.frames import Layer
from objconnect.scene.bundle.object_points import objects_of_points
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.runtime.progress import progress_bar

CLOSE_M = 0.5
"""A point closer than this to a surface lies on it."""

# Search radius (px) for the surface around an observation.
_REACH = 2
# Each pixel is modelled as a disc in space. Its radius is this share of the pixel's side, so that
# it covers the corners of a pixel seen from the front.
_DISC_RADIUS = float(np.sqrt(0.5))
# Scenes store the components of unit normals as integers, times this.
_NORMAL_SCALE = 127


@dataclass(frozen=True)
class Truth:
    """Ground truth of the points of a rendered scene's map.

    Attributes:
        owners: id (M,) of the object on which each point lies, 0 for the ground.
        distance_m: distance (M,) of each point from the surface of its object, metres; infinite
            where no photograph shows that surface near the point.
        ids_in_view: ids of the objects in the map's photographs.
        small_counts: number of small objects in each photograph, by name.
    """

    owners: NDArray[np.int64]
    distance_m: NDArray[np.float64]
    ids_in_view: frozenset[int]
    small_counts: Mapping[str, int]


@dataclass(frozen=True)
class SurfaceDistances:
    """Distances of points from the true surface.

    Attributes:
        points: number of points.
        close: share of the points within 0.5 m of the surface.
        median_m: median over the points that have a surface near them; None where there are none.
        p90_m: 90th percentile over these points; None where there are none.
    """

    points: int
    close: float
    median_m: float | None
    p90_m: float | None

    @staticmethod
    def of(distances: NDArray[np.float64]) -> SurfaceDistances:
        """Summarise distances (K,), metres, K > 0; infinite for points without a surface."""
        known = distances[np.isfinite(distances)]
        middle, high = np.percentile(known, [50, 90]).tolist() if len(known) else (None, None)
        return SurfaceDistances(len(distances), float((distances < CLOSE_M).mean()), middle, high)

    def text(self) -> str:
        """Return the statistics as text."""
        percentiles = "" if self.median_m is None else f"median {self.median_m:.3f} m, "
        percentiles += "" if self.p90_m is None else f"90 % under {self.p90_m:.3f} m, "
        return f"{percentiles}{self.close:.1%} of {self.points} within {CLOSE_M} m"


def read_truth(scene: Scene, sparse_map: SparseMap) -> Truth | None:
    """Measure a map's points against rendered surfaces; None for a scene without them.

    The distance of a point is that to the nearest surface patch of its object, among the pixels
    around all its observations.

    Raises:
        InputError: a file of the scene is damaged.
    """
    small = [item.id for item in scene.objects.objects if item.size_class == "small"]
    distance_m = np.full(len(sparse_map.xyz), np.inf)
    instances: list[tuple[MapImage, NDArray[np.uint16]]] = []
    for image, layers in scene.layers_of_map(sparse_map, "instance"):
        instances.append((image, layers["instance"]))
    if not instances:
        return None
    owners = objects_of_points(len(distance_m), instances)
    ids_in = {image.name: np.unique(instance) for image, instance in instances}
    with progress_bar("true surface", len(instances)) as advance:
        layers_of_images = scene.layers_of_map(sparse_map, "depth", "instance", "normal")
        for done, (image, layers) in enumerate(layers_of_images, 1):
            rows = image.point_rows[image.point_rows >= 0]
            distances = _distances(image, layers, sparse_map.xyz, owners)
            np.minimum.at(distance_m, rows, distances)
            advance(done)
    return Truth(
        owners=owners,
        distance_m=distance_m,
        ids_in_view=frozenset(np.concatenate(list(ids_in.values())).tolist()),
        small_counts={name: int(np.isin(ids, small).sum()) for name, ids in ids_in.items()},
    )


def _distances(
    image: MapImage,
    layers: Mapping[Layer, NDArray[Any]],
    xyz: NDArray[np.float64],
    owners: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the distances (K,), metres, between points and the surfaces of their objects.

    The points are those that the image observes. A distance is infinite where the image does not
    show the object near the observation.
    """
    observed = image.point_rows >= 0
    rows = image.point_rows[observed]
    height, width = layers["depth"].shape
    column, row = np.floor(image.xy[observed]).astype(int).T
    world_from_cam = image.pose.inverse()
    best = np.full(len(rows), np.inf)
    for down, right in product(range(-_REACH, _REACH + 1), repeat=2):
        at = (row + down).clip(0, height - 1), (column + right).clip(0, width - 1)
        depth = layers["depth"][at].astype(np.float64)
        rays, _ = image.camera.unproject(torch.from_numpy(np.stack(at[::-1], -1) + 0.5))
        patch = world_from_cam.transform(rays * torch.from_numpy(depth)[:, None]).numpy()
        normal = layers["normal"][at].astype(np.float64) / _NORMAL_SCALE
        offset = xyz[rows] - patch
        above = (offset * normal).sum(1)
        along = np.linalg.norm(offset - above[:, None] * normal, axis=1)
        radius = _DISC_RADIUS * depth / min(image.camera.focal)
        distance = np.hypot(above, np.maximum(along - radius, 0))
        shown = (depth > 0) & (layers["instance"][at] == owners[rows])
        best = np.where(shown, np.minimum(best, distance), best)
    return best
