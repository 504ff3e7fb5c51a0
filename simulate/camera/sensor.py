"""Photometric effects of lens and sensor, which do not change the geometry of a photograph.

The rendered sRGB picture is converted to linear light, to which exposure, vignetting, blur and
noise are applied. A rolling shutter is not applied here: every row is rendered with its own pose,
in all layers.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from objconnect.scene.config import Config

_BLUR_SAMPLES_PER_PX = 4
# Largest factors of exposure time and gain: from 1/1600 s to 1/32 s, and from ISO 100 to 3200.
_MAX_TIME_FACTOR, _MAX_GAIN = 50.0, 32.0


class SensorConfig(Config):
    """Photometric effects and rolling shutter, all off by default."""

    exposure_ev: float = Field(
        0.0, ge=0, le=3, description="Standard deviation of the exposure, stops."
    )
    white_balance: float = Field(
        0.0,
        ge=0,
        le=0.5,
        description="Relative standard deviation of the gains of red and blue, 0 to 0.5.",
    )
    vignetting: float = Field(
        0.0, ge=0, lt=1, description="Share of the light that is lost in the corners, 0 to 1."
    )
    motion_blur_px: float = Field(
        0.0,
        ge=0,
        le=50,
        description="Scale of the motion blur, px. Its length is the absolute value of a normal "
        "variable with this standard deviation, and its direction is random.",
    )
    full_well_e: float | None = Field(
        None,
        ge=100,
        description="Electrons of a white pixel, which determine the shot noise. None disables "
        "noise.",
    )
    read_noise_e: float = Field(
        0.0,
        ge=0,
        description="Standard deviation of the read noise, electrons; needs ``full_well_e``.",
    )
    readout_s: float = Field(
        0.0,
        ge=0,
        le=0.5,
        description="Readout time of the rolling shutter from top to bottom, s; 0 is a global "
        "shutter.",
    )

    follows_light: bool = Field(
        False,
        description="Whether exposure time and gain follow the light of the condition. "
        "``motion_blur_px`` and ``full_well_e`` then apply to summer noon. Dimmer light first "
        "lengthens the exposure, up to 50 times, and then raises the gain, up to 32 times.",
    )

    @model_validator(mode="after")
    def _check_noise(self) -> SensorConfig:
        if self.read_noise_e and self.full_well_e is None:
            raise ValueError("read_noise_e needs full_well_e: give both")
        return self

    @model_serializer(mode="wrap")
    def _omit_default(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out ``follows_light`` where it is off, as in the records of older scenes."""
        values: dict[str, Any] = dump(self)
        if not self.follows_light:
            del values["follows_light"]
        return values

    def adapt(self, dimness: float) -> SensorConfig:
        """Return the effects in light that is ``dimness`` stops dimmer than at summer noon.

        A longer exposure lengthens the motion blur. A higher gain saturates at fewer electrons.
        """
        if not self.follows_light:
            return self
        time_factor = min(2.0**dimness, _MAX_TIME_FACTOR)
        gain = min(2.0**dimness / time_factor, _MAX_GAIN)
        well = None if self.full_well_e is None else self.full_well_e / gain
        changed = {"motion_blur_px": self.motion_blur_px * time_factor, "full_well_e": well}
        return self.model_copy(update=changed)


def expose(
    rgb: NDArray[np.uint8], sensor: SensorConfig, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Apply the effects of a sensor to a rendered picture (H, W, 3) uint8 sRGB.

    Equal generators give equal photographs. The random values of all effects are drawn even
    when the effects are off, so that enabling one does not change the others.
    """
    # The order of the draws is fixed, and the noise comes last.
    stops, red, blue = rng.standard_normal(3)
    direction, length = rng.uniform(0, np.pi), abs(rng.standard_normal())
    applied_elsewhere = {"readout_s": 0.0, "follows_light": False}  # by the renderer and ``adapt``
    if sensor.model_copy(update=applied_elsewhere) == SensorConfig():
        return rgb
    light = _linear(rgb)
    height, width = light.shape[:2]
    light = _streak(light, direction, length * sensor.motion_blur_px)
    v, u = np.mgrid[:height, :width] + 0.5
    radius2 = (u / width - 0.5) ** 2 * width**2 + (v / height - 0.5) ** 2 * height**2
    light *= (1 - sensor.vignetting * radius2 / (0.25 * (width**2 + height**2)))[..., None]
    gains = np.exp(sensor.white_balance * np.array([red, 0.0, blue]))
    light *= gains * 2.0 ** (sensor.exposure_ev * stops)
    if sensor.full_well_e is not None:
        # For many electrons, the Poisson distribution is close to a normal one.
        electrons = sensor.full_well_e * np.minimum(light, 1.0)
        sigma = np.sqrt(electrons + sensor.read_noise_e**2)
        light = (electrons + sigma * rng.standard_normal(light.shape)) / sensor.full_well_e
    return _srgb(light)


def _streak(light: NDArray[np.float64], direction: float, length_px: float) -> NDArray[np.float64]:
    """Spread light (H, W, 3) evenly along a centred line."""
    half = 0.5 * length_px
    if half < 0.05:
        return light
    size = 2 * int(np.ceil(half)) + 3
    kernel = np.zeros((size, size))
    along = np.linspace(-half, half, int(np.ceil(_BLUR_SAMPLES_PER_PX * length_px)) + 1)
    for x, y in np.stack([along * np.cos(direction), along * np.sin(direction)], -1):
        i, j = int(np.floor(x)), int(np.floor(y))
        fx, fy = x - i, y - j
        mid = size // 2
        kernel[mid + j : mid + j + 2, mid + i : mid + i + 2] += np.outer([1 - fy, fy], [1 - fx, fx])
    blurred = cv2.filter2D(light, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(blurred)


def _linear(rgb: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Convert sRGB bytes to linear light in 0..1."""
    s = np.arange(256) / 255
    table = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
    return np.asarray(table[rgb])


def _srgb(light: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Convert linear light to sRGB bytes. Values above 1 are clipped."""
    s = np.clip(light, 0, 1)
    s = np.where(s <= 0.0031308, 12.92 * s, 1.055 * s ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * s), np.uint8)
