"""Reader of poses from a binary COLMAP model, which has no geodetic origin."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from objconnect.scene.imports.poses import ForeignPoses, Format, check_poses
from objconnect.scene.maps.colmap_files import read_model


def _read(path: Path) -> ForeignPoses:
    images = read_model(path).images
    matrices = np.array([image.cam_from_world for image in images.values()])
    cameras = [image.camera for image in images.values()]
    return check_poses(path, list(images), cameras, np.linalg.inv(matrices))


FORMAT = Format(
    lambda path: any((path / f"images.{ending}").is_file() for ending in ("bin", "txt")),
    _read,
    "a folder of a COLMAP model",
)
