"""Add triangulated centres of objects to a scene's map as points, and remove them."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from objconnect.mapping.supplement.association import Detections
from objconnect.mapping.supplement.triangulation import TriangulatedPoint
from objconnect.scene.bundle.manifest import write_json
from objconnect.scene.bundle.scene import MAP_FILES, Scene, finish_scene
from objconnect.scene.bundle.supplement import (
    ADDED_FEATURES,
    SUPPLEMENT,
    AddedPoint,
    Supplement,
    read_supplement,
)
from objconnect.scene.colmap.models import NewPoint, add_points, remove_points
from objconnect.scene.errors import InputError
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.features import Features, write_features
from objconnect.scene.storage.atomic import atomic_folder
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.leftovers import remove_partial
from objconnect.scene.storage.locks import write_lock


def add_to_map(
    path: Path,
    points: Sequence[TriangulatedPoint],
    detections: Mapping[str, Detections],
    map_sha256: str | None = None,
) -> Supplement:
    """Add points to the map of a scene; they replace points that were added before.

    Poses, points and keypoints of the map keep their values and identifiers. The added points are
    listed in ``map/supplement.json``; their descriptors are stored in ``map/supplement.h5``.

    Args:
        path: finished scene with a map.
        points: results of ``supplement_points`` or ``associate_and_triangulate``; each becomes one
            object.
        detections: detections by photograph, from which the points were triangulated.
        map_sha256: digest of the map to which the points belong; None skips the check.

    Raises:
        InputError: the scene is not finished, is being written by another run, has no map, a
            damaged one, or one with another digest.
    """
    scene = Scene.open(path)
    with write_lock(path):
        scene = Scene.open(path)  # another run may have changed it before the lock
        remove_partial(path)
        current = scene.sparse_map()  # raises if something is missing or damaged
        if map_sha256 not in (None, current.sha256):
            raise InputError(f"another run changed the map of {path}: run supplement again")
        new = [_new_point(scene, point, detections) for point in points]
        with atomic_folder(scene.map_path, MAP_FILES) as folder:
            _copy_without_added(scene, folder)
            before = read_model(folder)
            ids = add_points(folder, new, folder)
            added = [
                AddedPoint(id=number, object=k, confidence=point.confidence)
                for k, (number, point) in enumerate(zip(ids, points, strict=True))
            ]
            supplement = Supplement(points=tuple(added), map_sha256=before.sha256)
            write_json(folder / SUPPLEMENT, supplement)
            write_features(folder / ADDED_FEATURES, _features(points, detections))
        finish_scene(path, scene.manifest)
    return supplement


def remove_from_map(path: Path) -> int:
    """Remove the added points from the map of a scene, which restores its files byte for byte.

    Returns:
        The number of removed points.

    Raises:
        InputError: as ``add_to_map``, or no point was added.
    """
    scene = Scene.open(path)
    with write_lock(path):
        supplement = read_supplement(scene.map_path)
        if supplement is None:
            raise InputError(f"the map of {path} has no added points: there is nothing to remove")
        with atomic_folder(scene.map_path, MAP_FILES) as folder:
            _copy_without_added(scene, folder)
        finish_scene(path, scene.manifest)
    return len(supplement.points)


def _copy_without_added(scene: Scene, folder: Path) -> None:
    """Copy the map into a folder, without its added points."""
    for file in scene.map_path.iterdir():
        if file.name in MAP_FILES and file.name not in (SUPPLEMENT, ADDED_FEATURES):
            shutil.copyfile(file, folder / file.name)
    supplement = read_supplement(scene.map_path)
    if supplement is not None:
        remove_points(folder, [point.id for point in supplement.points], folder)


def _new_point(
    scene: Scene, point: TriangulatedPoint, detections: Mapping[str, Detections]
) -> NewPoint:
    """Make a map point with its colour in the photograph of highest confidence."""
    xy = {name: detections[name].xy[row] for name, row in point.rows.items()}
    surest = max(point.rows, key=lambda name: detections[name].confidence[point.rows[name]])
    rgb = read_rgb(scene.images_root / surest)
    column, row = np.floor(xy[surest]).astype(int)
    return NewPoint(
        point.xyz, rgb[row.clip(0, rgb.shape[0] - 1), column.clip(0, rgb.shape[1] - 1)], xy
    )


def _features(
    points: Sequence[TriangulatedPoint], detections: Mapping[str, Detections]
) -> dict[str, Features]:
    """Return the observations of the points as features, by photograph, in order of the points."""
    rows: dict[str, list[int]] = {}
    for point in points:
        for name, row in point.rows.items():
            rows.setdefault(name, []).append(row)
    return {
        name: Features(
            detections[name].xy[kept].astype(np.float32),
            np.ones(len(kept), np.float32),
            detections[name].descriptors[kept],
        )
        for name, kept in rows.items()
    }
