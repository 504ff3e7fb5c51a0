"""Reader of poses from ``reconstruction.json`` of OpenDroneMap and OpenSfM.

A shot holds the axis-angle vector and the translation of cam_from_world; camera axes are OpenCV's.
The world is east, north, up in metres from ``reference_lla``; if that is 0, 0, position and scale
of the world are arbitrary. Pixels are in units of the longer side, from the middle of the picture
(https://opensfm.org/docs/geometry.html). ODM writes a file in a projected system under the same
name: see ``odm_frame``.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, RootModel

from objconnect.scene.bundle.manifest import Vector, read_json
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic, is_on_earth, is_same_place
from objconnect.scene.imports.lens import LARGEST_SIDE, LONGEST_FOCAL, BrownLens, require_inside
from objconnect.scene.imports.odm_frame import TOPOCENTRIC, Shots, convert_to_topocentric
from objconnect.scene.imports.poses import (
    CoordinateFrame,
    ForeignPoses,
    Format,
    begins_with,
    check_poses,
)

log = logging.getLogger(__name__)


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
            InputError: the projection is unknown, or the parameters are invalid.
        """
        size = max(self.width, self.height)
        fx = self.focal_x if self.focal_x is not None else self.focal
        fy = self.focal_y if self.focal_y is not None else fx
        if fx is None or fy is None:
            raise InputError("no focal length")
        if not max(fx, fy) <= LONGEST_FOCAL:
            raise InputError(
                f"focal {max(fx, fy):g} is not in units of the picture's longer side (at most "
                f"{LONGEST_FOCAL:g})"
            )
        focal = (fx * size, fy * size)
        principal = (self.width / 2 + self.c_x * size, self.height / 2 + self.c_y * size)
        require_inside(principal, (self.width, self.height), ("c_x", "c_y"))
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
    gps_position: Vector | None = None


class _Reference(_Part):
    latitude: FiniteFloat
    longitude: FiniteFloat
    altitude: FiniteFloat

    @property
    def place(self) -> Geodetic:
        """Return the geodetic coordinates of the reference."""
        return Geodetic(self.latitude, self.longitude, self.altitude)


class _Reconstruction(_Part):
    cameras: dict[str, _Lens]
    shots: dict[str, _Shot]
    reference_lla: _Reference | None = None
    frame: Literal["topocentric"] | None = None  # written only by this project's own exports


class _Reconstructions(RootModel[list[_Reconstruction]]):
    pass


def _read(path: Path, frame: CoordinateFrame | None = None) -> ForeignPoses:
    """Read the largest reconstruction; the others have frames of their own."""
    reconstructions = read_json(path, _Reconstructions, "reconstruction").root
    if not reconstructions:
        raise InputError(f"{path} holds no reconstruction")
    best = max(reconstructions, key=lambda one: len(one.shots))
    used = {shot.camera for shot in best.shots.values()}
    missing = sorted(used - best.cameras.keys())
    if missing:
        raise InputError(f"{path}: a shot has the camera {missing[0]!r}, which the file lacks")
    cameras = {}
    for name in sorted(used):
        try:
            cameras[name] = best.cameras[name].camera()
        except InputError as error:
            raise InputError(f"{path}: camera {name!r}: {error}") from None
    shots, matrices, origin = _shots(path, best), _matrices(best), None
    if shots is None and frame is not None:
        raise InputError(
            f"{path} has no position in reference_lla, so GPS georegisters it: leave out "
            "--poses-frame"
        )
    if shots is not None:
        shots = convert_to_topocentric(path, shots, _read_sibling(path), frame)
        matrices, origin = shots.world_from_cam, shots.origin
    return check_poses(
        path,
        list(best.shots),
        [cameras[shot.camera] for shot in best.shots.values()],
        matrices,
        origin,
    )


def _matrices(reconstruction: _Reconstruction) -> NDArray[np.float64]:
    matrices = [_world_from_cam(shot) for shot in reconstruction.shots.values()]
    return np.array(matrices).reshape(-1, 4, 4)


def _shots(path: Path, reconstruction: _Reconstruction) -> Shots | None:
    """Return the shots in the frame of the file; None if it has no position on earth."""
    origin = _origin(path, reconstruction.reference_lla)
    if origin is None:
        return None
    if origin[:2] == (0.0, 0.0) and reconstruction.frame is None:
        log.warning("%s: reference_lla is 0, 0, OpenSfM's value without GPS: it is ignored", path)
        return None
    not_measured = (np.nan, np.nan, np.nan)
    measured = [shot.gps_position or not_measured for shot in reconstruction.shots.values()]
    return Shots(
        tuple(reconstruction.shots),
        _matrices(reconstruction),
        np.array(measured, np.float64).reshape(-1, 3),
        origin,
        reconstruction.frame,
    )


def _read_sibling(path: Path) -> Shots | None:
    """Return the shots of ODM's topocentric file in the same folder; None if there is none."""
    other = path.parent / TOPOCENTRIC
    if path.name == TOPOCENTRIC or not other.is_file():
        return None
    reconstructions = read_json(other, _Reconstructions, "reconstruction").root
    if not reconstructions:
        return None
    return _shots(other, max(reconstructions, key=lambda one: len(one.shots)))


def _world_from_cam(shot: _Shot) -> NDArray[np.float64]:
    import torch

    from objconnect.scene.geometry.pose import so3_exp

    rotation = so3_exp(torch.tensor(shot.rotation, dtype=torch.float64)).numpy()
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.T
    matrix[:3, 3] = -rotation.T @ np.array(shot.translation)
    return matrix


def _origin(path: Path, stated: _Reference | None) -> Geodetic | None:
    """Return the origin that the reconstruction states, else ``reference_lla.json`` beside it."""
    file = path.parent / "reference_lla.json"
    other = read_json(file, _Reference, "reference") if file.is_file() else None
    reference = stated or other
    if reference is None:
        return None
    origin = reference.place
    if not is_on_earth(origin):
        raise InputError(f"{path}: reference_lla is not a place on earth")
    if other is not None and not is_same_place(origin, other.place):
        raise InputError(
            f"{path}: its reference_lla differs from that of {file.name} beside it: "
            "remove the file of the other reconstruction"
        )
    return origin


FORMAT = Format(
    lambda path: path.suffix.lower() == ".json" and begins_with(path, "["),
    _read,
    "a reconstruction.json of ODM or OpenSfM",
    _read,
)
