"""Export to COLMAP: a binary model.

It holds the poses of all frames in world metres and, where the scene has a map, the map's points
with their observations. Image names are relative to the scene's folder ``sessions``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from scene.bundle.frames import Frames
from scene.bundle.scene import Scene
from scene.colmap.models import write_posed
from scene.maps.photographs import PosedImage


def write(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    """Write ``cameras.bin``, ``images.bin`` and ``points3D.bin``; see ``formats.Writer``."""
    images = [
        PosedImage(name, camera, pose)
        for frames in sessions.values()
        for name, camera, pose in zip(
            frames.names, frames.cameras, frames.cam_from_world, strict=True
        )
    ]
    sparse_map = scene.sparse_map() if scene.map_path.is_dir() else None
    write_posed(images, sparse_map, folder)
