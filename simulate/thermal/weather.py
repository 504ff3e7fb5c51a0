"""Air, sky and sun over the hours before a flight, from which surfaces take their temperature.

Sources:
    Emissivity of a clear sky, whole and from 8 to 14 micrometres, by the vapour pressure: Idso,
    Water Resources Research 17 (1981) 295. Radiation of clouds through the transparent part of the
    sky: Kimball, Idso and Aase, ibid. 18 (1982) 931. Saturation pressure: Magnus' formula. Direct
    sunlight: Meinel and Meinel, Applied Solar Energy (1976). The air's temperature is that of a
    mean year in the lowlands of Central Europe. It falls by 0.6 K per degree of latitude and by
    6.5 K per kilometre of height.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta
from math import cos, exp, isfinite, pi, radians, sin
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.geometry.geodesy import Geodetic
from simulate.look.conditions import Condition
from simulate.look.sun import sun_position
from simulate.thermal.planck import band_radiance

Array = NDArray[np.float64]

ZERO_C: Final = 273.15
"""The freezing point of water, kelvin."""
STEFAN_BOLTZMANN: Final = 5.670374419e-8
"""Radiated power of a black body, W/(m2 K4)."""
HOURS: Final = 13
"""Number of hours, with the present one, whose weather affects the temperature of surfaces."""

_SOLAR_W: Final = 1353.0  # solar constant in Meinel's formula, W/m2
# Shares of sunlight that a clear sky scatters down, and that clouds add.
_DIFFUSE, _DIFFUSE_OF_CLOUD = 0.11, 0.16
_MIN_SUN_DEG: Final = 2.0  # below it, the direct sun is left out
_WARMEST_HOUR: Final = 15.0
# Half the difference between day and night under a clear sky and under clouds, and the share of
# this difference that remains over snow.
_SWING_K, _SWING_OF_CLOUD_K = 6.0, 2.0
_SWING_OVER_SNOW: Final = 0.6
# The base of clouds is colder than the air at the ground by this.
_CLOUD_COOLER_K: Final = 8.0
# Mean length of paths through the sky over all directions, divided by that of the vertical path.
_DIFFUSIVITY: Final = 1.66
# Extinction by water vapour between 8 and 14 micrometres, 1/m per hPa: about 30 % in a kilometre of
# summer air.
_VAPOUR_EXTINCTION: Final = 2.5e-5
_FOG_M: Final = 1000.0  # at a lower visibility, droplets are as large as the wavelength
# Extinction by fog, rain and snowfall in the thermal band, divided by that of light.
_FOG_EXTINCTION: Final = 0.5


@dataclass(frozen=True)
class ThermalWeather:
    """The weather of the hours before a flight; element k of an array is k hours ago.

    Attributes:
        air_k: Temperature (HOURS,) of the air, kelvin.
        sun: Unit vectors (HOURS, 3) towards the sun, east-north-up.
        direct_w: Direct normal irradiance (HOURS,) by the sun, W/m2; 0 by night.
        diffuse_w: Irradiance (HOURS,) by the sky on level ground, W/m2.
        loss_w: Power that a level black surface of the air's temperature loses to the sky, W/m2.
        ground_k: Temperature below the surface of the ground, kelvin.
        water_k: Temperature of lakes and basins, kelvin.
        zenith_transmittance: Transmittance of the clear sky straight up, in the band.
        cloud: Cloud cover, 0 to 1.
        extinction: Extinction of the air in the band, 1/m.
    """

    air_k: Array
    sun: Array
    direct_w: Array
    diffuse_w: Array
    loss_w: float
    ground_k: float
    water_k: float
    zenith_transmittance: float
    cloud: float
    extinction: float

    @property
    def cloud_k(self) -> float:
        """Return the temperature of the base of clouds, kelvin."""
        return float(self.air_k[0]) - _CLOUD_COOLER_K

    def sky_radiance(self, up: Array) -> Array:
        """Return the radiance of the sky in the band, W/(m2 sr), at directions of any shape.

        Args:
            up: Sines of the elevations. At and below the horizon, the sky is as warm as the air.
        """
        path = np.minimum(1 / np.maximum(up, 1e-3), 40.0)
        return self._mix(self.zenith_transmittance**path)

    @property
    def mean_sky_radiance(self) -> float:
        """Return the radiance of the sky in the band that level ground receives, W/(m2 sr)."""
        return float(self._mix(np.array(self.zenith_transmittance**_DIFFUSIVITY)))

    def _mix(self, clear: Array) -> Array:
        """Return the radiance of a sky whose air has the transmittance ``clear``."""
        air, clouds = band_radiance(self.air_k[0]), band_radiance(self.cloud_k)
        return np.asarray((1 - clear) * air + clear * self.cloud * clouds)


def thermal_weather(condition: Condition, origin: Geodetic) -> ThermalWeather:
    """Return the weather of a condition at an origin."""
    weather = condition.weather
    mean_c = _mean_air_c(condition, origin)
    times = [condition.time - timedelta(hours=k) for k in range(HOURS)]
    hours = [_solar_hour(time.hour + time.minute / 60, origin) for time in times]
    swing = _SWING_K + weather.cloud * (_SWING_OF_CLOUD_K - _SWING_K)
    swing *= 1 + condition.season.snow * (_SWING_OVER_SNOW - 1)
    air_k = ZERO_C + mean_c + swing * np.cos(2 * pi * (np.array(hours) - _WARMEST_HOUR) / 24)
    positions = [sun_position(time, origin) for time in times]
    azimuth, elevation = np.radians(np.array(positions)).T
    sun = np.stack(
        [np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation),
         np.sin(elevation)], -1
    )  # fmt: skip
    clear = np.array([_direct(degrees) for degrees in np.degrees(elevation)])
    diffuse = _SOLAR_W * (_DIFFUSE + _DIFFUSE_OF_CLOUD * weather.cloud)
    # The relative humidity is higher under clouds.
    humidity = 0.65 + 0.25 * weather.cloud
    vapour_hpa = humidity * _saturation_hpa(mean_c)
    now = float(air_k[0])
    # Emissivity of a clear sky, over all wavelengths and in the band.
    emissivity = 0.70 + 5.95e-5 * vapour_hpa * exp(1500 / now)
    band_emissivity = 0.24 + 2.98e-8 * vapour_hpa**2 * exp(3000 / now)
    sky_w = STEFAN_BOLTZMANN * (
        emissivity * now**4 + (1 - emissivity) * weather.cloud * (now - _CLOUD_COOLER_K) ** 4
    )
    return ThermalWeather(
        air_k=air_k,
        sun=sun,
        direct_w=clear * (1 - 0.96 * weather.cloud),
        diffuse_w=diffuse * np.maximum(np.sin(elevation), 0),
        loss_w=STEFAN_BOLTZMANN * now**4 - sky_w,
        ground_k=ZERO_C + mean_c + 1.0,
        water_k=ZERO_C + _water_c(condition, origin),
        zenith_transmittance=max(1 - band_emissivity, 0.0) ** (1 / _DIFFUSIVITY),
        cloud=weather.cloud,
        extinction=_VAPOUR_EXTINCTION * vapour_hpa + _fog_extinction(condition),
    )


def _mean_air_c(condition: Condition, origin: Geodetic) -> float:
    """Return the mean temperature of the air on the day, degrees Celsius.

    Lying snow limits the temperature to -2 degrees, and snow in full thaw to 4 degrees.
    """
    mean = _yearly_c(condition, origin, coldest_day=22.0)
    if condition.season.snow > 0:
        mean = min(mean, -2.0 + 6.0 * condition.season.thaw)
    return mean


def _water_c(condition: Condition, origin: Geodetic) -> float:
    """Return the temperature of lakes, degrees Celsius, which lags the air by 18 days."""
    return max(2.0, 1.0 + _yearly_c(condition, origin, coldest_day=40.0))


def _yearly_c(condition: Condition, origin: Geodetic, coldest_day: float) -> float:
    """Return a temperature, degrees Celsius, with a yearly cycle around the mean of the place."""
    latitude = abs(origin.latitude)
    mean = min(13.0 + 0.6 * (47.0 - latitude), 27.0) - 0.0065 * max(origin.altitude, 0.0)
    swing = 10.0 * sin(radians(latitude)) / sin(radians(47.0))
    day = condition.time.timetuple().tm_yday - (0.0 if origin.latitude >= 0 else 182.5)
    return mean - swing * cos(2 * pi * (day - coldest_day) / 365.25)


def _solar_hour(utc_hour: float, origin: Geodetic) -> float:
    return (utc_hour + origin.longitude / 15) % 24


def _direct(elevation_deg: float) -> float:
    """Return the direct normal irradiance by the sun under a clear sky, W/m2."""
    if elevation_deg < _MIN_SUN_DEG:
        return 0.0
    mass = 1 / (sin(radians(elevation_deg)) + 0.50572 * (elevation_deg + 6.07995) ** -1.6364)
    return float(_SOLAR_W * 0.7 ** (mass**0.678))


def _saturation_hpa(celsius: float) -> float:
    return 6.112 * exp(17.62 * celsius / (243.12 + celsius))


def _fog_extinction(condition: Condition) -> float:
    """Return the extinction by fog, rain and snowfall, 1/m. Haze is finer than the wavelength."""
    weather = condition.weather
    thick = weather.visibility_m < _FOG_M or weather.rain > 0 or weather.snowfall > 0
    if not thick or not isfinite(weather.visibility_m):
        return 0.0
    return _FOG_EXTINCTION * 3.912 / weather.visibility_m
