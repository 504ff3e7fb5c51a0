"""Falling rain and snow in front of the camera, drawn over a finished picture.

Drops and flakes are particles between the camera and the scene. They do not change depth, objects,
classes or normals. Distant particles are not drawn, because the visibility of the weather includes
them. Terminal velocities: Gunn and Kinzer (1949) for rain, Locatelli and Hobbs (1974) for snow.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from simulate.camera.pinhole import PinholeCamera
from simulate.look.conditions import Condition

Array = NDArray[np.float64]

_NEAREST_M: Final = 0.35  # smallest distance of particles
_EXPOSURE_S: Final = 1 / 160  # exposure time of photographs in rain and snowfall
_NIGHT_EXPOSURE_S: Final = 1 / 30
_DRIFT_M_S: Final = 3.0  # standard deviation of the camera's horizontal speed in the air, per axis
_SHIFT: Final = 3  # fractional bits of OpenCV's sub-pixel drawing
_FOCUS_M: Final = 0.6  # particles nearer than this are out of focus
_NIGHT_LIGHT: Final = 0.35  # brightness of lamplit particles at night, relative to the sky


class _Particles(NamedTuple):
    """Drops or flakes.

    Attributes:
        per_m3: Number of visible particles in a cubic metre.
        farthest_m: Distance up to which particles are drawn.
        diameter_m: Median diameter.
        spread: Standard deviation of the diameter's logarithm.
        fall_m_s: Speed of fall, metres per second.
        light: Brightness of a particle relative to the sky. Drops refract the sky's light, and
            flakes scatter it.
    """

    per_m3: float
    farthest_m: float
    diameter_m: float
    spread: float
    fall_m_s: float
    light: float


_DROPS: Final = _Particles(50.0, 5.0, 0.0025, 0.25, 7.5, 1.6)
_FLAKES: Final = _Particles(70.0, 6.0, 0.0055, 0.4, 1.2, 1.5)


def draw_precipitation(
    rgb: NDArray[np.uint8],
    camera: PinholeCamera,
    cam_from_world: Array,
    condition: Condition,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Draw falling rain and snow over a picture; return it, (H, W, 3) uint8 sRGB.

    Args:
        rgb: The picture.
        camera: Camera of the picture; for a lens with distortion, the pinhole that covers its view.
        cam_from_world: Pose (4, 4) of the picture, Z up.
        condition: The condition, whose sky lights the particles.
        rng: Generator of the particles; equal generators give equal pictures.
    """
    weather = condition.weather
    picture = rgb
    for amount, kind in ((weather.rain, _DROPS), (weather.snowfall, _FLAKES)):
        if amount > 0:
            veil = _draw(camera, cam_from_world, amount, kind, condition.night is not None, rng)
            colour = kind.light * _particle_rgb(condition)
            mixed = picture + veil[..., None] * np.maximum(colour - picture, 0)
            picture = np.asarray(np.rint(mixed.clip(0, 255)), np.uint8)
    return picture


def _particle_rgb(condition: Condition) -> Array:
    """Return the colour (3,), in 0..255 sRGB, of a surface as bright as the sky near the horizon.

    At night the surface is lamplit, and ``_NIGHT_LIGHT`` times as bright. The renderer's tone curve
    is approximated by 1 - exp(-1.1 x).
    """
    light = np.array(condition.sky.horizon) * condition.sky.strength * 2**condition.exposure
    shown = 1 - np.exp(-1.1 * light * (1.0 if condition.night is None else _NIGHT_LIGHT))
    return np.asarray(255 * shown ** (1 / 2.2))


def _draw(
    camera: PinholeCamera,
    cam_from_world: Array,
    amount: float,
    kind: _Particles,
    at_night: bool,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """Return the opacity (H, W), 0 to 1, of streaks of particles that pass during the exposure."""
    view_m2 = camera.width * camera.height / camera.f**2  # at a distance of 1 m
    volume = view_m2 * (kind.farthest_m**3 - _NEAREST_M**3) / 3
    count = rng.poisson(amount * kind.per_m3 * volume)
    share = rng.random(count)
    z = np.cbrt(_NEAREST_M**3 + share * (kind.farthest_m**3 - _NEAREST_M**3))
    middle = rng.random((count, 2)) * [camera.width, camera.height]
    diameter = kind.diameter_m * np.exp(kind.spread * rng.standard_normal(count))
    velocity = np.array([*(_DRIFT_M_S * rng.standard_normal(2)), -kind.fall_m_s])
    exposure_s = _NIGHT_EXPOSURE_S if at_night else _EXPOSURE_S
    travel = exposure_s * (cam_from_world[:3, :3] @ velocity)
    ray = (middle - [camera.cx, camera.cy]) / camera.f
    streak = camera.f * (travel[:2] - ray * travel[2]) / z[:, None]  # pixels
    size = camera.f * diameter / z
    blur = np.maximum(size * _FOCUS_M / np.minimum(z, _FOCUS_M), 1.0)  # width in the picture
    length = np.hypot(*streak.T)
    # A particle covers each pixel of its streak for a part of the exposure.
    opacity = np.minimum(1.0, size**2 / (blur * (blur + length)))
    veil = np.zeros((camera.height, camera.width), np.uint8)
    ends = np.rint(np.stack([middle - 0.5 * streak, middle + 0.5 * streak], 1) * (1 << _SHIFT))
    limit = float(1 << 24)
    for k in np.argsort(opacity):
        (x0, y0), (x1, y1) = ends[k].clip(-limit, limit).astype(int).tolist()
        shade, width = round(255 * opacity[k]), max(1, round(blur[k]))
        cv2.line(veil, (x0, y0), (x1, y1), shade, width, cv2.LINE_AA, _SHIFT)
    return np.asarray(cv2.GaussianBlur(veil, (0, 0), 0.5).astype(np.float32) / 255)
