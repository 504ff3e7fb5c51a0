"""Poses of OpenDroneMap and OpenSfM: ``reconstruction.json``.

A shot's rotation is the axis-angle vector of cam_from_world and its translation that of
cam_from_world; camera axes are OpenCV's. The world is east, north, up in metres from
``reference_lla``. Pixels are in units of the longer side, from the middle of the picture
(https://opensfm.org/docs/geometry.html).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, RootModel

from scene.bundle.manifest import Vector, read_json
from scene.errors import InputError
from scene.geometry.camera import Camera
from scene.geometry.geodesy import Geodetic, is_on_earth
from scene.imports.lens import LARGEST_SIDE, BrownLens
from scene.imports.poses import ForeignPoses, Format, begins_with, posed


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class _Lens(_Part):
    projection_type: str = "perspective"
    width: int = Field(gt=0, le=LARGEST_SIDE)
    height: int = Field(gt=0, le=LARGEST_SIDE)
    focal: float | None = None
    focal_x: float | None = None
    focal_y: float | None = None
    c_x: float = 0.0
    c_y: float = 0.0
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    def camera(self) -> Camera:
        """Return the camera.

        Raises:
            InputError: the projection is unknown, or the numbers are those of no camera.
        """
        size = max(self.width, self.height)
        fx = self.focal_x if self.focal_x is not None else self.focal
        fy = self.focal_y if self.focal_y is not None else fx
        if fx is None or fy is None:
            raise InputError("no focal length")
        focal = (fx * size, fy * size)
        principal = (self.width / 2 + self.c_x * size, self.height / 2 + self.c_y * size)
        radial = (self.k1, self.k2, self.k3, self.k4)
        if self.projection_type in ("fisheye", "fisheye_opencv"):
            params = (*focal, *principal, *radial)
            return Camera("OPENCV_FISHEYE", self.width, self.height, params)
        if self.projection_type not in ("perspective", "simple_radial", "radial", "brown"):
            raise InputError(f"projection {self.projection_type!r} is not supported")
        tangential = (self.p1, self.p2)
        return BrownLens((self.width, self.height), focal, principal, radial, tangential).camera()


class _Shot(_Part):
    rotation: Vector
    translation: Vector
    camera: str


class _Reference(_Part):
    latitude: FiniteFloat
    longitude: FiniteFloat
    altitude: FiniteFloat


class _Reconstruction(_Part):
    cameras: dict[str, _Lens]
    shots: dict[str, _Shot]
    reference_lla: _Reference | None = None


class _Reconstructions(RootModel[list[_Reconstruction]]):
    pass


def _read(path: Path) -> ForeignPoses:
    """Read the reconstruction of most photographs; others are in frames of their own."""
    found = read_json(path, _Reconstructions, "reconstruction").root
    if not found:
        raise InputError(f"{path} holds no reconstruction")
    best = max(found, key=lambda one: len(one.shots))
    used = {shot.camera for shot in best.shots.values()}
    missing = sorted(used - best.cameras.keys())
    if missing:
        raise InputError(f"{path}: a shot has the camera {missing[0]!r}, which is not there")
    cameras = {}
    for name in sorted(used):
        try:
            cameras[name] = best.cameras[name].camera()
        except InputError as error:
            raise InputError(f"{path}: camera {name!r}: {error}") from None
    matrices = [_world_from_cam(shot) for shot in best.shots.values()]
    return posed(
        path,
        list(best.shots),
        [cameras[shot.camera] for shot in best.shots.values()],
        np.array(matrices).reshape(-1, 4, 4),
        _origin(path, best.reference_lla),
    )


def _world_from_cam(shot: _Shot) -> NDArray[np.float64]:
    import torch

    from scene.geometry.pose import so3_exp

    rotation = so3_exp(torch.tensor(shot.rotation, dtype=torch.float64)).numpy()
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.T
    matrix[:3, 3] = -rotation.T @ np.array(shot.translation)
    return matrix


def _origin(path: Path, reference: _Reference | None) -> Geodetic | None:
    if reference is None:
        return None
    origin = Geodetic(reference.latitude, reference.longitude, reference.altitude)
    if not is_on_earth(origin):
        raise InputError(f"{path}: reference_lla is no place on earth")
    return origin


FORMAT = Format(
    lambda path: path.suffix.lower() == ".json" and begins_with(path, "["),
    _read,
    "a reconstruction.json of ODM or OpenSfM",
)
