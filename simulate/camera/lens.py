"""Cameras of photographs, by COLMAP's parameters or by name, and their pinholes for rendering.

Blender renders pinhole pictures. For a camera with distortion, it renders a pinhole picture that
covers the camera's view, from which ``simulate.camera.resample`` computes the photograph.

Torch is imported only where a distortion is computed, so that the configuration of a scene and the
help of the command line load without it.
"""

from __future__ import annotations

import math

from pydantic import Field, model_validator

from objconnect.scene.config import Config
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from simulate.camera.pinhole import PinholeCamera

# The side of a pinhole picture grows with the tangent of half the field of view. Beyond this field
# of view, nearly all of its pixels would be unused.
_MAX_FOV_DEG = 140.0
_MARGIN_PX = 4.0  # margin around the view for the resampling kernels
_SAMPLE_STEP_PX = 16  # distance between positions at which the distortion is sampled

PRESETS: dict[str, tuple[int, int, float, tuple[float, ...]]] = {
    "mini-2": (4000, 3000, 83.0, ()),
    "mini-2-wide": (4000, 2250, 78.16, ()),
    "mavic-3": (5280, 3956, 84.0, ()),
    "phantom-3": (4000, 3000, 94.0, ()),
    "phantom-4-pro": (5472, 3648, 84.0, ()),
    "phantom-4-rtk-raw": (5472, 3648, 84.0, (-0.27, 0.11, 0.0, 0.0)),
    "cmu-c0": (1024, 768, 72.85, (-0.399, 0.189, 0.0002, 0.0006)),
    "cmu-c1": (1024, 768, 72.37, (-0.397, 0.182, 0.0002, -0.0006)),
}
"""Known cameras: full width and height (px), diagonal field of view (deg), and k1, k2, p1, p2.

The principal point is the centre, except where ``_PRINCIPAL`` has another. The values are nominal.
For a real drone, calibrate its camera.

Sources: All sizes agree with published ones (the DroneModels table of calibrated drone cameras
lists FC7303, L2D-20C, FC300 and FC6310 with these). The field of view of the Phantom 4 Pro and RTK
follows from 8.8 mm and a sensor of 13.2 x 8.8 mm, that of the Mavic 3 from its equivalent focal
length of 24 mm, and that of the Phantom 3 is quoted by its owners. No source confirms the 83
degrees of the Mini 2.

Assumptions: "mini-2-wide" is a crop of "mini-2". The coefficients of "phantom-4-rtk-raw", the
survey drone without the correction of its JPEGs, have a typical size but belong to no real camera.
All other drones are assumed to correct distortion completely. "cmu-c0" and "cmu-c1" resemble the
two cameras on the car of CMU Seasons: wide lenses with barrel distortion and principal points off
the centre.
"""
# Principal points that are not the centre, as shares of width and height.
_PRINCIPAL = {"cmu-c0": (0.514, 0.547), "cmu-c1": (0.517, 0.517)}


class CameraConfig(Config):
    """A camera: COLMAP's parameters, or the name of a known camera."""

    model: str | None = Field(None, description="COLMAP camera model.")
    width: int | None = Field(None, ge=16, le=8192, description="Width of photographs, px.")
    height: int | None = Field(None, ge=16, le=8192, description="Height of photographs, px.")
    params: tuple[float, ...] | None = Field(
        None, description="Parameters of the model in COLMAP's order."
    )
    preset: str | None = Field(
        None, description="Name of a known camera in ``PRESETS``, instead of all fields above."
    )
    size: int | None = Field(
        None,
        ge=64,
        le=8192,
        description="Longer side of the preset's photographs, px. None takes the scene's.",
    )

    @model_validator(mode="after")
    def _check_source(self) -> CameraConfig:
        given = [self.model, self.width, self.height, self.params]
        if self.preset is not None:
            if any(value is not None for value in given):
                raise ValueError("give a preset, or model, width, height and params, not both")
            if self.preset not in PRESETS:
                raise ValueError(f"unknown camera {self.preset!r}; known: {', '.join(PRESETS)}")
        elif any(value is None for value in given) or self.size is not None:
            raise ValueError("give a preset (and size), or model, width, height and params")
        cover_by_pinhole(self.build(64))
        return self

    def build(self, size: int) -> Camera:
        """Return the camera; a preset without its own size gets the longer side ``size``."""
        if self.preset is None:
            assert self.model is not None
            assert self.width is not None
            assert self.height is not None
            assert self.params is not None
            return Camera(self.model, self.width, self.height, self.params)
        width, height, fov_deg, distortion = PRESETS[self.preset]
        scale = (self.size or size) / width
        focal = 0.5 * scale * math.hypot(width, height) / math.tan(math.radians(0.5 * fov_deg))
        width, height = round(width * scale), round(height * scale)
        right, down = _PRINCIPAL.get(self.preset, (0.5, 0.5))
        params = (focal, focal, right * width, down * height, *distortion)
        return Camera("OPENCV" if distortion else "PINHOLE", width, height, params)


def cover_by_pinhole(camera: Camera) -> tuple[PinholeCamera, str | None]:
    """Return the pinhole camera to render for a camera, and the distorted camera of the render job.

    The pinhole covers the camera's view with at least the camera's resolution. The distorted camera
    is ``str(camera)``, or None where the camera is a pinhole itself.

    Raises:
        InputError: the view is too wide for a pinhole, or the picture exceeds the valid range of
            the distortion.
    """
    (fx, fy), (cx, cy) = camera.focal, camera.principal
    if fx == fy and not camera.is_fisheye and not any(camera.distortion):
        return PinholeCamera(width=camera.width, height=camera.height, f=fx, cx=cx, cy=cy), None
    import torch

    grid = camera.pixel_grid()
    edge = torch.cat([grid[0], grid[-1], grid[:, 0], grid[:, -1]])
    inside = grid[::_SAMPLE_STEP_PX, ::_SAMPLE_STEP_PX].reshape(-1, 2)
    rays, valid = camera.unproject(torch.cat([edge, inside]))
    if not bool(valid.all()):
        raise InputError(
            f"camera {camera}: its distortion is not invertible over the whole picture; use a "
            "smaller picture or other coefficients"
        )
    angle = 2 * float(torch.rad2deg(torch.atan(rays[:, :2].norm(dim=-1).max())))
    if angle > _MAX_FOV_DEG:
        raise InputError(
            f"camera {camera} has a field of view of {angle:.0f} degrees, at most "
            f"{_MAX_FOV_DEG:.0f} can be rendered: use a longer focal length"
        )
    jacobian = camera.project(rays, jacobian=True).jacobian
    assert jacobian is not None
    f = float(torch.linalg.matrix_norm(jacobian[..., :2], ord=2).max())
    low, high = (f * rays[:, :2].amin(0) - _MARGIN_PX), (f * rays[:, :2].amax(0) + _MARGIN_PX)
    width, height = (math.ceil(float(side)) for side in high - low)
    pinhole = PinholeCamera(width=width, height=height, f=f, cx=-float(low[0]), cy=-float(low[1]))
    return pinhole, str(camera)
