"""The pictures of a thermal camera: blur, noise, 16-bit counts, and the range of 8-bit pictures."""

from __future__ import annotations

from math import ceil, floor
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.thermal import Thermal
from objconnect.scene.geometry.geodesy import Geodetic
from simulate.look.conditions import Condition
from simulate.thermal.planck import band_radiance, brightness_temperature
from simulate.thermal.substances import NAMES, property_array
from simulate.thermal.surfaces import Surfaces
from simulate.thermal.weather import ZERO_C, ThermalWeather, thermal_weather

NETD_K: Final = 0.05
"""Noise of a pixel that sees 300 K, as a standard deviation in kelvin. Datasheets of uncooled
cameras state 0.03 to 0.06 K."""
BLUR_PX: Final = 0.6
"""Standard deviation of the blur by lens and pixel, pixels."""

_NOISE_AT_K: Final = 300.0
_KELVIN_PER_COUNT: Final = 0.01
# Level surfaces look colder by up to this, because they reflect the sky.
_SKY_REFLECTION_K: Final = 3.0
# Substances left out of the range of 8-bit pictures, because they reflect the sky or are small.
_IGNORED: Final = ("bare sheet", "solar cell", "rubber", "iron")


def describe_thermal(condition: Condition, origin: Geodetic) -> Thermal:
    """Return the metadata of thermal pictures under a condition: coding, noise and range.

    The temperature range of the 8-bit pictures is in whole degrees. It includes level surfaces in
    the sun and in the shade.
    """
    weather = thermal_weather(condition, origin)
    low, high = _level_range(weather, condition.wet)
    low -= _SKY_REFLECTION_K
    return Thermal(
        kelvin_per_count=_KELVIN_PER_COUNT,
        netd_k=NETD_K,
        air_c=round(float(weather.air_k[0]) - ZERO_C, 2),
        low_c=float(floor(low - ZERO_C)),
        high_c=float(ceil(high - ZERO_C)),
    )


def _level_range(weather: ThermalWeather, wet: float) -> tuple[float, float]:
    """Return the temperatures of the coldest and the warmest level surface, kelvin.

    Substances in ``_IGNORED`` are left out.
    """
    surfaces = Surfaces(weather, wet)
    usual = np.array([k for k, name in enumerate(NAMES) if name not in _IGNORED], np.int16)
    lit = weather.diffuse_w + weather.direct_w * np.maximum(weather.sun[:, 2], 0)
    albedo, ones = property_array("albedo")[usual], np.ones(len(usual), np.float32)
    by_light = [
        surfaces.temperature(usual, albedo, (surfaces.weights[usual] @ light).astype("f4"), ones)
        for light in (lit, weather.diffuse_w)
    ]
    return float(np.min(by_light)), float(np.max(by_light))


def expose_thermal(
    radiance: NDArray[np.float32], record: Thermal, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """Return the counts (H, W) of a thermal camera that receives a radiance (H, W), W/(m2 sr).

    The noise is constant in radiance, so that it is larger in kelvin in cold scenes. Equal
    generators give equal pictures.
    """
    slope = band_radiance(_NOISE_AT_K + 0.5) - band_radiance(_NOISE_AT_K - 0.5)
    blurred = cv2.GaussianBlur(radiance, (0, 0), BLUR_PX, borderType=cv2.BORDER_REFLECT_101)
    seen = blurred + record.netd_k * slope * rng.standard_normal(radiance.shape)
    counts = np.rint(brightness_temperature(seen) / record.kelvin_per_count)
    return np.asarray(np.clip(counts, 0, 65535), np.uint16)
