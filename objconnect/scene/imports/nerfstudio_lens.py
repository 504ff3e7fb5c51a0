"""Reader of lenses from ``transforms.json`` of nerfstudio and instant-ngp.

A file states a lens redundantly: ``camera_model`` and ``is_fisheye`` its type, ``fl_x`` and
``camera_angle_x`` its focal length. Contradictory fields and unsupported lenses are errors.
"""

from __future__ import annotations

import re
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.imports.lens import LARGEST_SIDE, BrownLens, require_inside
from objconnect.scene.quantities.flags import parse_flag
from objconnect.scene.quantities.view_angle import contradicts, focal_lengths

# Coefficients of each model; others must be zero or missing.
_COEFFICIENTS: Final = {
    "SIMPLE_PINHOLE": (),
    "PINHOLE": (),
    "SIMPLE_RADIAL": ("k1",),
    "RADIAL": ("k1", "k2"),
    "OPENCV": ("k1", "k2", "k3", "k4", "p1", "p2"),
    "SIMPLE_RADIAL_FISHEYE": ("k1",),
    "RADIAL_FISHEYE": ("k1", "k2"),
    "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4"),
}
_ONE_FOCAL_MODELS: Final = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE")
# Keys that change the lens or the pose and are not supported.
_UNSUPPORTED_KEYS: Final = re.compile(
    r"k[0-9]+|p[0-9]+|s[0-9]+|b[0-9]+|[sc]x[0-9]|sy[0-9]|xi|omega|skew|alpha|beta|ftheta_p\d|"
    r"f_?theta.*|latlong|equirectangular|orthographic|lens_params|rolling_shutter|from_na|"
    r"camera_convention|coordinate_system|transform_matrix_(start|end)|distortion.*",
    re.IGNORECASE,
)
# A focal length below this share of the longer side is not in pixels. A principal point whose
# coordinates are at most 1 is not in pixels either.
_MIN_FOCAL_SHARE, _MAX_RELATIVE = 0.05, 1.0


class Intrinsics(BaseModel):
    """The intrinsics of a file or of one of its frames: lengths in pixels, angles in radians."""

    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False)

    camera_model: str | None = None
    is_fisheye: bool | float | str | None = None
    camera_angle_x: float | None = None
    camera_angle_y: float | None = None
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
        """Return the camera; None if size or focal length are missing.

        Raises:
            InputError: the model is not supported, fields contradict each other, or the parameters
                are invalid.
        """
        _refuse_unsupported(self.model_extra or {})
        model = self._model()
        if self.w is None or self.h is None or self.fl_x is None:
            return None
        width, height = _require_whole("w", self.w), _require_whole("h", self.h)
        fisheye = model.endswith("FISHEYE")
        focal = self._focal(self.fl_x, (width, height), fisheye)
        if model in _ONE_FOCAL_MODELS and focal[0] != focal[1]:
            raise InputError(f"camera_model {model} has one focal length, but fl_y is not fl_x")
        principal = (
            width / 2 if self.cx is None else self.cx,
            height / 2 if self.cy is None else self.cy,
        )
        if max(map(abs, principal)) <= _MAX_RELATIVE < min(width, height):
            raise InputError(f"cx, cy {principal} are not in pixels of {width} x {height}")
        require_inside(principal, (width, height), ("cx", "cy"))
        k1, k2, k3, k4, p1, p2 = (getattr(self, name) or 0.0 for name in _COEFFICIENTS["OPENCV"])
        if fisheye:
            params = (*focal, *principal, k1, k2, k3, k4)
            return Camera("OPENCV_FISHEYE", width, height, params)
        lens = BrownLens((width, height), focal, principal, (k1, k2, k3, k4), (p1, p2))
        return lens.camera()

    def _model(self) -> str:
        """Return the model that ``camera_model`` and ``is_fisheye`` agree on."""
        flag = None if self.is_fisheye is None else parse_flag(self.is_fisheye)
        if self.is_fisheye is not None and flag is None:
            raise InputError(f"is_fisheye is {self.is_fisheye!r}, neither true nor false")
        default = "OPENCV_FISHEYE" if flag else "OPENCV"
        model = default if self.camera_model is None else self.camera_model.strip().upper()
        if model not in _COEFFICIENTS:
            raise InputError(f"camera_model {self.camera_model!r} is not supported")
        if flag is not None and flag != model.endswith("FISHEYE"):
            raise InputError(
                f"camera_model {model} and is_fisheye {self.is_fisheye!r} contradict each other"
            )
        values = {name: getattr(self, name) for name in _COEFFICIENTS["OPENCV"]}
        lost = [name for name, v in values.items() if v and name not in _COEFFICIENTS[model]]
        if lost:
            field = "camera_model" if self.camera_model is not None else "is_fisheye"
            raise InputError(f"{field} says {model}, which has no {', '.join(lost)}")
        return model

    def _focal(self, fl_x: float, size: tuple[int, int], fisheye: bool) -> tuple[float, float]:
        """Return the focal lengths (pixels), checked against the angles of view."""
        fl_y = fl_x if self.fl_y is None else self.fl_y
        if min(fl_x, fl_y) < _MIN_FOCAL_SHARE * max(size):
            raise InputError(f"fl_x, fl_y {fl_x:g}, {fl_y:g} are not focal lengths in pixels")
        stated = (("x", fl_x, self.camera_angle_x), ("y", fl_y, self.camera_angle_y))
        for (axis, focal, angle), side in zip(stated, size, strict=True):
            if angle is not None and contradicts(focal, angle, side, fisheye):
                other = ", ".join(f"{f:.1f}" for f in focal_lengths(angle, side, fisheye))
                raise InputError(
                    f"fl_{axis} {focal:g} and camera_angle_{axis} {angle:g} contradict each other: "
                    f"across {side} pixels, the angle gives a focal length of {other or 'none'}"
                )
        return fl_x, fl_y


def _refuse_unsupported(keys: dict[str, Any]) -> None:
    """Refuse unsupported keys that change the lens or the pose.

    Raises:
        InputError: such a key has a value other than zero, false or empty.
    """
    for key, value in keys.items():
        if _UNSUPPORTED_KEYS.fullmatch(key) and _is_set(value):
            raise InputError(f"the key {key!r} changes the camera and is not supported")


def _is_set(value: object) -> bool:
    if isinstance(value, list):
        return any(map(_is_set, value))
    if isinstance(value, str):
        return parse_flag(value) is not False
    return bool(value)


def _require_whole(name: str, value: float) -> int:
    if value != round(value):
        raise InputError(f"{name} is {value:g}, but a picture has whole pixels")
    return int(value)
