"""Poses of nerfstudio: ``transforms.json``.

``transform_matrix`` is world_from_cam with OpenGL's camera axes (x right, y up, looking along -z);
pixels are COLMAP's. ``applied_transform`` is what nerfstudio applied to the original world, and is
undone (https://docs.nerf.studio/quickstart/data_conventions.html). The file places nothing on
earth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from scene.bundle.manifest import read_json
from scene.errors import InputError
from scene.geometry.camera import Camera
from scene.imports.lens import LARGEST_SIDE, BrownLens
from scene.imports.poses import ForeignPoses, Format, begins_with, posed

_FILE = "transforms.json"
_Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
_PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE")


class _Intrinsics(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)

    camera_model: str | None = None
    w: float | None = Field(None, gt=0, le=LARGEST_SIDE)
    h: float | None = Field(None, gt=0, le=LARGEST_SIDE)
    fl_x: float | None = None
    fl_y: float | None = None
    cx: float | None = None
    cy: float | None = None
    k1: float | None = None
    k2: float | None = None
    k3: float | None = None
    k4: float | None = None
    p1: float | None = None
    p2: float | None = None

    def camera(self) -> Camera | None:
        """Return the camera, or None where size or focal length are not there.

        Raises:
            InputError: the model is not supported, or the numbers are those of no camera.
        """
        if self.w is None or self.h is None or self.fl_x is None:
            return None
        width, height = int(self.w), int(self.h)
        focal = (self.fl_x, self.fl_x if self.fl_y is None else self.fl_y)
        principal = (
            width / 2 if self.cx is None else self.cx,
            height / 2 if self.cy is None else self.cy,
        )
        radial = (self.k1 or 0.0, self.k2 or 0.0, self.k3 or 0.0, self.k4 or 0.0)
        model = self.camera_model or "OPENCV"
        if model == "OPENCV_FISHEYE":
            return Camera(model, width, height, (*focal, *principal, *radial))
        if model not in _PERSPECTIVE:
            raise InputError(f"camera model {model!r} is not supported")
        tangential = (self.p1 or 0.0, self.p2 or 0.0)
        return BrownLens((width, height), focal, principal, radial, tangential).camera()


class _Frame(_Intrinsics):
    file_path: str
    transform_matrix: tuple[_Row, _Row, _Row, _Row]


class _Document(_Intrinsics):
    frames: tuple[_Frame, ...]
    applied_transform: tuple[_Row, _Row, _Row] | None = None


def _read(path: Path) -> ForeignPoses:
    file = path / _FILE if path.is_dir() else path
    document = read_json(file, _Document, "nerfstudio's transforms")
    shared = document.model_dump(exclude={"frames", "applied_transform"}, exclude_none=True)
    cameras = []
    for frame in document.frames:
        own = frame.model_dump(exclude={"file_path", "transform_matrix"}, exclude_none=True)
        try:
            cameras.append(_Intrinsics.model_validate(shared | own).camera())
        except InputError as error:
            raise InputError(f"{file}: {frame.file_path}: {error}") from None
    matrices = np.array([frame.transform_matrix for frame in document.frames]).reshape(-1, 4, 4)
    if document.applied_transform is not None:
        applied = np.vstack([np.array(document.applied_transform), [0.0, 0.0, 0.0, 1.0]])
        try:
            matrices = np.linalg.inv(applied) @ matrices
        except np.linalg.LinAlgError:
            raise InputError(f"{file}: applied_transform has no inverse") from None
    # OpenGL's camera looks along -z with y up.
    turned = matrices @ np.diag([1.0, -1.0, -1.0, 1.0])
    names = [frame.file_path for frame in document.frames]
    return posed(file, names, cameras, turned)


FORMAT = Format(
    lambda path: (
        (path / _FILE).is_file() or (path.suffix.lower() == ".json" and begins_with(path, "{"))
    ),
    _read,
    "a transforms.json of nerfstudio",
)
