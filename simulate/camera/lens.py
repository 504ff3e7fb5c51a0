"""Cameras of photographs: given by COLMAP's parameters or by name, and how they are rendered.

Blender renders pinholes. Every other camera is seen through a pinhole that covers its view, and
`simulate.camera.resample` takes each of its pixels from there.

Torch is imported only where a lens is looked at, so that the configuration of a scene, and the help
of the command line with it, loads without it.
"""

from __future__ import annotations

import math

from pydantic import Field, model_validator

from scene.config import Config
from scene.errors import InputError
from scene.geometry.camera import Camera
from simulate.camera.pinhole import PinholeCamera

# A pinhole picture grows with the tangent of the angle: beyond, nearly all of it is thrown away.
_MAX_FOV_DEG = 140.0
_MARGIN_PX = 4.0  # around the view, for the resampling kernels
_COARSE = 16  # pixels between the positions where the scale of the picture is looked at

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
"""Full resolution width and height (px), diagonal field of view (deg), k1 k2 p1 p2; principal point
in the middle unless `_PRINCIPAL` says. Nominal: a drone at hand has to be calibrated.

Held against published figures: all sizes (the DroneModels table of calibrated drone cameras has
FC7303, L2D-20C, FC300 and FC6310 with these). 84 degrees of the Phantom 4 Pro and RTK is what
8.8 mm before 13.2 x 8.8 mm sees, and 84 degrees of the Mavic 3 what its 24 mm equivalent does; 94
degrees of the Phantom 3 is the diagonal that its owners quote. Not found again: 83 degrees of the
Mini 2. Not of a maker: "mini-2-wide" is the middle of the "mini-2", and the coefficients of
"phantom-4-rtk-raw", the survey drone with the correction of its JPEGs switched off, have the size
of published ones but are of no camera. The others are taken to correct their distortion fully.
"cmu-c0" and "cmu-c1" are like the two cameras on the car of CMU Seasons: wide lenses bent inwards,
neither like the other nor centred.
"""
# Principal points that are not in the middle, as shares of width and height.
_PRINCIPAL = {"cmu-c0": (0.514, 0.547), "cmu-c1": (0.517, 0.517)}


class CameraConfig(Config):
    """The camera of the photographs: COLMAP's parameters, or the name of a known one.

    Attributes:
        model: COLMAP camera model.
        width: pixels.
        height: pixels.
        params: in COLMAP's order for the model.
        preset: a key of ``PRESETS``, in place of the others.
        size: long side of the preset's photographs, pixels; None takes the scene's.
    """

    model: str | None = None
    width: int | None = Field(None, ge=16, le=8192)
    height: int | None = Field(None, ge=16, le=8192)
    params: tuple[float, ...] | None = None
    preset: str | None = None
    size: int | None = Field(None, ge=64, le=8192)

    @model_validator(mode="after")
    def _one_way(self) -> CameraConfig:
        given = [self.model, self.width, self.height, self.params]
        if self.preset is not None:
            if any(value is not None for value in given):
                raise ValueError("a preset takes no model, width, height or params")
            if self.preset not in PRESETS:
                raise ValueError(f"unknown camera {self.preset!r}; known: {', '.join(PRESETS)}")
        elif any(value is None for value in given) or self.size is not None:
            raise ValueError("a camera is a preset (and size), or model, width, height and params")
        rendered_through(self.build(64))
        return self

    def build(self, size: int) -> Camera:
        """The camera; a preset without a size of its own has the long side `size`."""
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


def rendered_through(camera: Camera) -> tuple[PinholeCamera, str | None]:
    """The pinhole to render for `camera`, and the lens of the job, None where they are the same.

    The pinhole covers the view of every pixel of the camera, at least as finely.

    Raises:
        InputError: a view wider than a pinhole can cover, or a picture larger than what the
            distortion can reach.
    """
    (fx, fy), (cx, cy) = camera.focal, camera.principal
    if fx == fy and not camera.is_fisheye and not any(camera.distortion):
        return PinholeCamera(width=camera.width, height=camera.height, f=fx, cx=cx, cy=cy), None
    import torch

    grid = camera.pixel_grid()
    edge = torch.cat([grid[0], grid[-1], grid[:, 0], grid[:, -1]])
    inside = grid[::_COARSE, ::_COARSE].reshape(-1, 2)
    rays, valid = camera.unproject(torch.cat([edge, inside]))
    if not bool(valid.all()):
        raise InputError(
            f"camera {camera}: its picture reaches beyond where the distortion folds back; "
            "use a smaller picture or other coefficients"
        )
    angle = 2 * float(torch.rad2deg(torch.atan(rays[:, :2].norm(dim=-1).max())))
    if angle > _MAX_FOV_DEG:
        raise InputError(
            f"camera {camera} sees {angle:.0f} degrees; at most {_MAX_FOV_DEG:.0f} can be rendered"
        )
    jacobian = camera.project(rays, jacobian=True).jacobian
    assert jacobian is not None
    f = float(torch.linalg.matrix_norm(jacobian[..., :2], ord=2).max())
    low, high = (f * rays[:, :2].amin(0) - _MARGIN_PX), (f * rays[:, :2].amax(0) + _MARGIN_PX)
    width, height = (math.ceil(float(side)) for side in high - low)
    pinhole = PinholeCamera(width=width, height=height, f=f, cx=-float(low[0]), cy=-float(low[1]))
    return pinhole, str(camera)
