"""Export to COLMAP: a binary model, and a database of features and matches.

The model holds the poses of all frames in world metres and, if the scene has a map, its points with
their observations. Image names are relative to the scene's folder ``sessions``. Model and database
share identifiers.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.colmap.database import write_matches
from objconnect.scene.colmap.models import write_with_poses
from objconnect.scene.exports.matches import iterate_matches, read_map_features
from objconnect.scene.maps.photographs import PosedImage


def write(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    """Write ``cameras.bin``, ``images.bin`` and ``points3D.bin``; see ``formats.Writer``."""
    sparse_map = scene.sparse_map() if scene.map_path.is_dir() else None
    write_with_poses(_images(sessions), sparse_map, folder)


def write_with_database(
    scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path
) -> None:
    """Write the model and ``database.db``: cameras, images, features and verified matches.

    Photographs that are not in the map have no features in the database. See ``formats.Writer``.

    Raises:
        InputError: the scene has no map or no covisibility, or its features are missing or are not
            the map's.
    """
    sparse_map, features = read_map_features(scene)
    images = _images(sessions)
    write_with_poses(images, sparse_map, folder)
    names = {image.name for image in images}
    matches = [(a, b, rows) for a, b, rows in iterate_matches(scene, sparse_map) if {a, b} <= names]
    exported = {name: features[name] for name in sparse_map.names if name in names}
    write_matches(folder / "database.db", images, exported, matches)


def _images(sessions: Mapping[str, Frames]) -> list[PosedImage]:
    return [
        PosedImage(name, camera, pose)
        for frames in sessions.values()
        for name, camera, pose in zip(
            frames.names, frames.cameras, frames.cam_from_world, strict=True
        )
    ]
