"""Reader of poses from nerfstudio's ``transforms.json``.

``transform_matrix`` is world_from_cam with OpenGL's camera axes (x right, y up, looking along -z);
pixels are COLMAP's. nerfstudio applies ``applied_transform`` and then ``applied_scale`` to the
original world; this reader undoes both. ``orientation_override`` changes no pose of the file
(https://docs.nerf.studio/quickstart/data_conventions.html). The file has no geodetic origin.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat

from objconnect.scene.bundle.manifest import read_json
from objconnect.scene.errors import InputError
from objconnect.scene.imports.nerfstudio_lens import Intrinsics
from objconnect.scene.imports.poses import ForeignPoses, Format, begins_with, check_poses

_FILE = "transforms.json"
_Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class _Frame(Intrinsics):
    file_path: str
    transform_matrix: tuple[_Row, _Row, _Row, _Row]


class _Document(Intrinsics):
    frames: tuple[_Frame, ...]
    applied_transform: tuple[_Row, _Row, _Row] | tuple[_Row, _Row, _Row, _Row] | None = None
    applied_scale: FiniteFloat | None = Field(None, gt=1e-6, lt=1e6)


_DOCUMENT_FIELDS = {"frames", "applied_transform", "applied_scale"}
_FRAME_FIELDS = {"file_path", "transform_matrix"}
_LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])


def _read(path: Path) -> ForeignPoses:
    file = path / _FILE if path.is_dir() else path
    document = read_json(file, _Document, "nerfstudio's transforms")
    shared = document.model_dump(exclude=_DOCUMENT_FIELDS, exclude_none=True)
    cameras = []
    for frame in document.frames:
        frame_values = frame.model_dump(exclude=_FRAME_FIELDS, exclude_none=True)
        try:
            cameras.append(Intrinsics.model_validate(shared | frame_values).camera())
        except InputError as error:
            raise InputError(f"{file}: {frame.file_path}: {error}") from None
    matrices = np.array([frame.transform_matrix for frame in document.frames]).reshape(-1, 4, 4)
    for frame, matrix in zip(document.frames, matrices, strict=True):
        if not np.allclose(matrix[3], _LAST_ROW, rtol=0, atol=1e-6):
            raise InputError(
                f"{file}: transform_matrix of {frame.file_path!r} does not end with the row "
                "0 0 0 1: transpose it if it is stored by columns"
            )
    matrices = _undo_transform(file, document, matrices)
    # OpenGL's camera looks along -z with y up.
    world_from_cam = matrices @ np.diag([1.0, -1.0, -1.0, 1.0])
    names = [frame.file_path for frame in document.frames]
    return check_poses(file, names, cameras, world_from_cam)


def _undo_transform(
    file: Path, document: _Document, matrices: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Undo the scale and then the transform that nerfstudio applied to the original world."""
    if document.applied_scale is not None:
        matrices[:, :3, 3] /= document.applied_scale
    if document.applied_transform is None:
        return matrices
    applied = np.vstack([np.array(document.applied_transform)[:3], _LAST_ROW])
    if len(document.applied_transform) == 4 and document.applied_transform[3] != tuple(_LAST_ROW):
        raise InputError(f"{file}: applied_transform does not end with the row 0 0 0 1")
    try:
        return np.asarray(np.linalg.inv(applied) @ matrices)
    except np.linalg.LinAlgError:
        raise InputError(f"{file}: applied_transform has no inverse") from None


FORMAT = Format(
    lambda path: (
        (path / _FILE).is_file() or (path.suffix.lower() == ".json" and begins_with(path, "{"))
    ),
    _read,
    "a transforms.json of nerfstudio",
)
