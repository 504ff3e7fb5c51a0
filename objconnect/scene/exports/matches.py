"""The features of a map and their matches for export.

Two keypoints match if they observe the same point of the map.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.covisibility import MIN_SHARED_SURFACE
from objconnect.scene.bundle.scene import FEATURES, Scene
from objconnect.scene.errors import InputError
from objconnect.scene.maps.features import FeatureFile
from objconnect.scene.maps.sparse_map import SparseMap

LEAST_MATCHES: Final = 15
"""Smallest number of matches of an exported pair, as in COLMAP."""


def read_map_features(scene: Scene) -> tuple[SparseMap, FeatureFile]:
    """Return a scene's map without added points and their keypoints, and its features.

    Added keypoints are left out because they have descriptors of another kind.

    Raises:
        InputError: the scene has no map, or its features are missing or are not the map's.
    """
    scene_map = scene.sparse_map()
    sparse_map = scene_map.drop_points(scene.is_added_point(scene_map))
    features = FeatureFile(scene.map_path / FEATURES)
    images = {}
    for name, image in sparse_map.images.items():
        count = len(features[name].xy) if name in features else -1
        if not 0 <= count <= len(image.xy):
            raise InputError(
                f"{features.path} does not hold the features of {name} in the map: run "
                f"'objconnect map {scene.path}'"
            )
        rows = image.point_rows[:count]
        images[name] = replace(image, xy=image.xy[:count], point_rows=rows)
    return replace(sparse_map, images=images), features


def map_pairs(scene: Scene) -> list[tuple[str, str]]:
    """Return the pairs of covisible frames of a scene's map, in map order.

    Raises:
        InputError: the scene has no covisibility.
    """
    names = scene.splits.map
    mutual = np.triu(scene.covisibility.select(names).mutual, 1)
    return [(names[i], names[j]) for i, j in np.argwhere(mutual >= MIN_SHARED_SURFACE)]


def iterate_matches(
    scene: Scene, sparse_map: SparseMap
) -> Iterator[tuple[str, str, NDArray[np.int64]]]:
    """Yield the names and matches of the covisible pairs of a map.

    Matches are (K, 2) keypoints of the first and of the second photograph, K >= ``LEAST_MATCHES``.
    """
    observations = {}
    for name, image in sparse_map.images.items():
        keypoints = np.flatnonzero(image.point_rows >= 0)
        points, first = np.unique(image.point_rows[keypoints], return_index=True)
        observations[name] = points, keypoints[first]
    for a, b in map_pairs(scene):
        if a not in observations or b not in observations:
            continue
        (points_a, keypoints_a), (points_b, keypoints_b) = observations[a], observations[b]
        _, i, j = np.intersect1d(points_a, points_b, assume_unique=True, return_indices=True)
        if len(i) >= LEAST_MATCHES:
            yield a, b, np.stack([keypoints_a[i], keypoints_b[j]], -1)
