"""Density of features on small objects: features per 1000 pixels of map photographs, by method.

``python -m experiments.feature_density SCENE [CACHE]`` (a scene with a map and rendered objects;
CACHE is that of an evaluation). It counts the features in the map's photographs that a method
compares queries with: keypoints with a 3D point, or points for alignment. ``objects`` is the
object-connect network with all its blocks. Methods that weigh features by a confidence have a
second line, weighted by it.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.datasets.open import open_datasets
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.matching.structure import StructureLocalizer
from objconnect.mapping.dense.report import GROUPS, Groups
from objconnect.methods import create
from objconnect.network.localizer import SHIPPED
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.localizer import Localizer
from objconnect.scene.maps.sparse_map import MapImage

_METHODS = ("sift", "d2net", "pixloc", "objconnect", "objects")
_KINDS = GROUPS[1:]
_SMALL = _KINDS.index("small")


class _WeightedPoints(NamedTuple):
    """World points (N, 3) of the features of a photograph, and their weights (N,)."""

    xyz: NDArray[np.float64]
    weight: NDArray[np.float64]


def _create_localizer(method: str) -> Localizer:
    if method == "objects":
        return create(
            "objconnect", {"weights": SHIPPED.with_name("objconnect-objects.safetensors")}
        )
    return create(method, {})


def _feature_points(localizer: Localizer, row: int) -> Iterator[_WeightedPoints]:
    """Yield the features with equal weights, then with their confidences."""
    if isinstance(localizer, StructureLocalizer):
        xyz = localizer._lifted_keypoints(row).xyz
        yield _WeightedPoints(xyz, np.ones(len(xyz)))
    elif isinstance(localizer, FeaturemetricLocalizer):
        observations = localizer.map_state.refine.problems.observations[row]
        yield _WeightedPoints(observations.xyz, np.ones(len(observations.xyz)))
        yield _WeightedPoints(observations.xyz, observations.confidence.astype(np.float64).prod(1))


def _identify(
    image: MapImage, xyz: NDArray[np.float64], instance: NDArray[np.uint16]
) -> NDArray[np.uint16]:
    """Return the identifiers (N,) of the objects at the pixels of points."""
    xy = image.camera.project(image.pose.transform(torch.from_numpy(xyz))).xy.numpy()
    columns, rows = np.floor(xy).astype(int).T
    height, width = instance.shape
    return np.asarray(instance[rows.clip(0, height - 1), columns.clip(0, width - 1)])


def main(path: Path, cache: Path) -> None:
    """Print the table."""
    scene, (dataset, *_) = Scene.open(path), open_datasets(path)
    sparse_map = dataset.load_map()
    groups = Groups(scene)
    instances = {
        image.name: layers["instance"]
        for image, layers in scene.layers_of_map(sparse_map, "instance")
    }
    pixels = np.bincount(groups.of(np.stack(list(instances.values()))).ravel(), minlength=4)
    print("features per 1000 px   all  " + "  ".join(f"{group:>7s}" for group in _KINDS)
          + "  small to all  small objects with one")  # fmt: skip
    for method in _METHODS:
        localizer = _create_localizer(method)
        localizer.prepare(sparse_map, dataset.images, cache)
        totals: list[NDArray[np.float64]] = []
        small_objects = with_feature = 0
        for row, name in enumerate(sparse_map.names):
            image, instance = sparse_map.images[name], instances[name]
            ids = np.unique(instance)
            small_ids = set(ids[groups.of(ids) == _SMALL].tolist())
            for weighting, features in enumerate(_feature_points(localizer, row)):
                ids_at_features = _identify(image, features.xyz, instance)
                counts = np.bincount(groups.of(ids_at_features), features.weight, minlength=4)
                if weighting == len(totals):
                    totals.append(np.zeros(4))
                totals[weighting] += counts
                if weighting == 0:
                    small_objects += len(small_ids)
                    with_feature += len(small_ids.intersection(ids_at_features.tolist()))
        for weighting, total in enumerate(totals):
            each, overall = 1000 * total / pixels, 1000 * total.sum() / pixels.sum()
            end = (
                f"  {with_feature / small_objects:.0%} of {small_objects}" if weighting == 0 else ""
            )
            print(
                f"{method + ('', ', weighed')[weighting]:20s}{overall:7.2f}  "
                + "  ".join(f"{value:7.2f}" for value in each)
                + f"  {each[_SMALL] / overall:12.2f}{end}",
                flush=True,
            )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        main(Path(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else folder))
