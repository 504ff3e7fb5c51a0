"""Reader of poses from ``cameras.json`` of 3D Gaussian splatting.

``rotation`` is the rotation of world_from_cam, row by row, and ``position`` the camera centre;
camera axes are OpenCV's (``camera_to_JSON`` in the program's ``utils/camera_utils.py``). The world
is that of the COLMAP model from which the splats were trained. Cameras are not read, because the
file lacks principal points.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, RootModel

from objconnect.scene.bundle.manifest import Vector, read_json
from objconnect.scene.imports.poses import ForeignPoses, Format, check_poses

# A file of this format has these keys in the first object of its list, within this many bytes.
_HEAD_BYTES = 4096
_KEYS = re.compile(rb'^\xef?\xbb?\xbf?\s*\[\s*\{(?=[^{}]*"img_name")(?=[^{}]*"position")')


class _Entry(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)

    img_name: str
    position: Vector
    rotation: tuple[Vector, Vector, Vector]


class _Entries(RootModel[list[_Entry]]):
    pass


def _read(path: Path) -> ForeignPoses:
    entries = read_json(path, _Entries, "cameras of 3D Gaussian splatting").root
    matrices = np.tile(np.eye(4), (len(entries), 1, 1))
    for matrix, entry in zip(matrices, entries, strict=True):
        matrix[:3, :3], matrix[:3, 3] = entry.rotation, entry.position
    return check_poses(path, [entry.img_name for entry in entries], [None] * len(entries), matrices)


def _matches(path: Path) -> bool:
    if path.suffix.lower() != ".json" or not path.is_file():
        return False
    try:
        with path.open("rb") as stream:
            return _KEYS.match(stream.read(_HEAD_BYTES)) is not None
    except OSError:
        return False


FORMAT = Format(_matches, _read, "a cameras.json of 3D Gaussian splatting")
