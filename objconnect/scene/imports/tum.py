"""Reader of trajectories of the TUM RGB-D benchmark: lines "timestamp tx ty tz qx qy qz qw".

The poses are world_from_cam in metres. A photograph's name is the text of its timestamp (seconds).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from objconnect.scene.errors import InputError
from objconnect.scene.imports.poses import ForeignPoses, Format, check_poses
from objconnect.scene.maps.colmap_files import check_pose
from objconnect.scene.storage.files import read_text

_COLUMNS = "timestamp tx ty tz qx qy qz qw"


def _read(path: Path) -> ForeignPoses:
    from objconnect.scene.geometry.pose import Pose

    names, rows = [], []
    for number, line in enumerate(read_text(path, "trajectory").split("\n"), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            values = np.zeros(0)
        if len(values) != len(_COLUMNS.split()):
            raise InputError(f"{path}:{number}: expected the numbers {_COLUMNS}")
        check_pose(values[4:], values[1:4], f"{path}:{number}")
        names.append(words[0])
        rows.append(values)
    table = np.array(rows).reshape(-1, 8)
    wxyz = np.roll(table[:, 4:], 1, axis=1)
    matrices = Pose.from_quaternion(wxyz, table[:, 1:4]).matrix().numpy()
    return check_poses(path, names, [None] * len(names), matrices)


FORMAT = Format(
    lambda path: path.is_file() and path.suffix.lower() in (".txt", ".tum"),
    _read,
    "a TUM trajectory (.txt, .tum)",
)
