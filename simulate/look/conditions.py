"""Conditions: a season, a light and, optionally, a weather, as in "autumn-dusk-fog".

A condition determines the appearance of a place and the time of a flight. It does not change the
geometry of a place; ``simulate.place.change`` does.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from functools import cache
from math import exp, inf, log2, pi, radians, sin
from typing import TypeVar

import numpy as np

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.registry import Registry
from simulate.look.seasons import SEASONS, Season
from simulate.look.sun import SunPosition, sun_position
from simulate.place.world import Rgb

DEFAULT_ORIGIN = Geodetic(47.0, 8.0, 450.0)
"""The geodetic origin of places that state no other."""


@dataclass(frozen=True)
class Light:
    """A time of day.

    Attributes:
        elevation: Elevation of the sun, degrees. None means half an hour before solar noon. Values
            below 0 mean night, with moon, street lamps, lit windows and headlights.
        rising: Whether the sun has this elevation before noon; otherwise after noon.
    """

    elevation: float | None
    rising: bool = False


_LIGHTS: dict[str, Light] = {
    "morning": Light(25.0, rising=True),
    "noon": Light(None),
    "afternoon": Light(35.0),
    "dusk": Light(10.0),
    "night": Light(-12.0),
}
LIGHTS = Registry("light", "objconnect.lights", _LIGHTS, lambda e: isinstance(e, Light))
# A light's elevation is limited to this share of the sun's elevation at noon.
_SHARE_OF_NOON = 0.6
_MIN_NOON_DEG = 3.0  # minimum elevation of the sun at noon

# Light is rendered on a brighter scale by night than by day, by this many stops. An irradiance of
# 1 W/m2 stands for 100,000 lux / 6 by day, and for about 15 lux by night, as under a street lamp.
_NIGHT_STOPS = 10.0
# Irradiance (W/m2), elevation and linear colour of the moon.
_MOON_W, _MOON_DEG, _MOON_RGB = 0.02, 40.0, (0.75, 0.86, 1.0)
_GLOW = 0.012  # strength of the sky at night
_STREET_W = 0.25  # mean irradiance of streets by lamps, which the camera meters
_NIGHT_UNDEREXPOSURE = 1.0  # stops
# Share of windows that are lit, by the hour of mean solar time.
_LIT_WINDOWS = ((0.0, 0.12), (2.0, 0.03), (5.0, 0.06), (7.0, 0.4), (16.0, 0.4), (19.0, 0.55),
                (21.5, 0.45), (24.0, 0.12))  # fmt: skip
_MELTWATER = 0.7  # wetness of the ground under thawing snow


@dataclass(frozen=True)
class Weather:
    """The weather: clouds, fog, rain, snowfall and floods.

    Attributes:
        cloud: Cloud cover, 0 to 1. It turns the sky grey, and dims and softens the sun.
        visibility_m: Distance in metres at which fog leaves 2 % of the contrast (Koschmieder).
        wet: Wetness, 0 to 1. It darkens surfaces, and puts a film of water and puddles on paved
            ground.
        rain: Rain that falls, 0 to 1 for a downpour.
        snowfall: Snow that falls, 0 to 1 for a dense snowfall.
        flood: Share of meadows, fields and paths under standing water, the lowest first.
    """

    cloud: float = 0.0
    visibility_m: float = inf
    wet: float = 0.0
    rain: float = 0.0
    snowfall: float = 0.0
    flood: float = 0.0


_WEATHER: dict[str, Weather] = {
    "clear": Weather(),
    "overcast": Weather(cloud=1.0),
    "fog": Weather(cloud=1.0, visibility_m=800.0),
    "wet": Weather(wet=1.0),
    "haze": Weather(cloud=0.2, visibility_m=5000.0),
    "rain": Weather(cloud=1.0, visibility_m=4000.0, wet=1.0, rain=1.0),
    "snowfall": Weather(cloud=1.0, visibility_m=1500.0, snowfall=1.0),
    "flood": Weather(cloud=0.5, wet=0.4, flood=0.35),
}
WEATHER = Registry("weather", "objconnect.weather", _WEATHER, lambda e: isinstance(e, Weather))


@dataclass(frozen=True)
class Sun:
    """The sun or the moon at a time.

    Attributes:
        azimuth: Degrees clockwise from north.
        elevation: Degrees above the horizon.
        angle: Diameter of the disc, degrees; cloud widens it.
        watts: Irradiance in W/m2, on Blender's scale.
        rgb: Linear colour.
    """

    azimuth: float
    elevation: float
    angle: float
    watts: float
    rgb: Rgb


@dataclass(frozen=True)
class Sky:
    """The sky at a time.

    Attributes:
        zenith: Linear colour straight above.
        horizon: Linear colour at the horizon, and of fog.
        strength: Factor on both colours, as in Blender's background.
    """

    zenith: Rgb
    horizon: Rgb
    strength: float


@dataclass(frozen=True)
class Night:
    """The lights of a night.

    Attributes:
        moon: A nearly full moon. Its position is not that of the real moon.
        windows: Share of windows that are lit at the hour.
    """

    moon: Sun
    windows: float


@dataclass(frozen=True)
class Condition:
    """A season, a light and a weather over a place.

    Attributes:
        name: SEASON-LIGHT[-WEATHER].
        time: Start of flights under the condition.
        sun: The sun at that time, through the clouds. Below the horizon it has no power.
        sky: The sky at that time.
        exposure: Exposure of the photographs, stops.
        noon: Position of the sun at noon of mean solar time.
        night: The lights of the night; None by day.
    """

    name: str
    time: datetime
    season: Season
    weather: Weather
    sun: Sun
    sky: Sky
    exposure: float
    noon: SunPosition
    night: Night | None = None

    @property
    def wet(self) -> float:
        """Return the wetness of the ground by rain or by melting snow, 0 to 1."""
        return max(self.weather.wet, _MELTWATER * self.season.thaw)

    @property
    def luminary(self) -> Sun:
        """Return the sun by day, and the moon by night."""
        return self.sun if self.night is None else self.night.moon

    @property
    def dimness(self) -> float:
        """Return the stops by which a camera exposes more than at summer noon, at least 0."""
        scale = 0.0 if self.night is None else _NIGHT_STOPS
        return max(0.0, self.exposure + scale - condition("summer-noon").exposure)


@cache
def condition(name: str, origin: Geodetic = DEFAULT_ORIGIN) -> Condition:
    """Return the condition SEASON-LIGHT[-WEATHER] at an origin; the default weather is clear.

    Raises:
        InputError: a part of the name is unknown, or at that latitude the sun does not rise to 3
            degrees on the day of the season or, for a night, never sinks far enough.
    """
    words = name.split("-")
    if len(words) not in (2, 3):
        raise InputError(
            f"unknown condition {name!r}: write SEASON-LIGHT[-WEATHER], such as summer-noon, "
            f"winter-dusk or autumn-morning-fog; seasons: {', '.join(SEASONS)}; lights: "
            f"{', '.join(LIGHTS)}; weather: {', '.join(WEATHER)}"
        )
    season = _part(SEASONS, words[0], "season", name)
    light = _part(LIGHTS, words[1], "light", name)
    weather = _part(WEATHER, words[2] if len(words) == 3 else "clear", "weather", name)

    if light.elevation is not None and light.elevation < 0:
        time, hour = _night_time(name, season, light, origin)
        sun, sky, night = _night_light(time, hour, weather, origin)
    else:
        time, night = _time(name, season, light, origin), None
        azimuth, elevation = sun_position(time, origin)
        watts, sun_rgb = _sunlight(elevation)
        watts *= 1 - 0.96 * weather.cloud
        sun = Sun(azimuth, elevation, 0.53 + 14.0 * weather.cloud, watts, sun_rgb)
        sky = _sky(elevation, weather.cloud)
    return Condition(
        name=name.removesuffix("-clear"),
        time=time,
        season=season,
        weather=weather,
        sun=sun,
        sky=sky,
        exposure=_exposure(sun, sky, season, weather, night),
        noon=sun_position(_midnight(season, origin) + timedelta(hours=12), origin),
        night=night,
    )


T = TypeVar("T")


def _part(known: Registry[T], word: str, kind: str, name: str) -> T:
    if word not in known:
        raise InputError(
            f"unknown condition {name!r}: no {kind} {word!r}, choose one of {', '.join(known)}"
        )
    return known[word]


def _time(name: str, season: Season, light: Light, origin: Geodetic) -> datetime:
    """Return the UTC minute of the season's day at which the sun matches the light."""
    first = _midnight(season, origin)
    minutes = [first + timedelta(minutes=k) for k in range(1440)]
    elevations = [sun_position(minute, origin).elevation for minute in minutes]
    noon = max(range(1440), key=elevations.__getitem__)
    if elevations[noon] < _MIN_NOON_DEG:
        raise InputError(
            f"condition {name!r} has no daylight at latitude {origin.latitude:g} on "
            f"{_day(season, origin)}: choose another season or origin"
        )
    if light.elevation is None:
        return minutes[noon - 30]  # before noon, so that shadows do not lie due north
    wanted = min(light.elevation, _SHARE_OF_NOON * elevations[noon])
    half_day = range(noon) if light.rising else range(noon, 1440)
    return minutes[min(half_day, key=lambda k: abs(elevations[k] - wanted))]


def _day(season: Season, origin: Geodetic) -> date:
    """Return the season's day, which is half a year later in the southern hemisphere."""
    return season.day if origin.latitude >= 0 else season.day + timedelta(days=182)


def _midnight(season: Season, origin: Geodetic) -> datetime:
    """Return the midnight of mean solar time at which the season's day begins."""
    day = _day(season, origin)
    midnight = datetime(day.year, day.month, day.day, tzinfo=UTC)
    return midnight - timedelta(minutes=round(origin.longitude * 4))


def _night_time(
    name: str, season: Season, light: Light, origin: Geodetic
) -> tuple[datetime, float]:
    """Return the UTC minute at which the sun matches an elevation below 0, and the solar hour.

    The day is the season's, or the nearest day on which the sun sinks that far. In the polar night
    the sun may be lower.

    Raises:
        InputError: the sun never sinks that far at the latitude.
    """
    elevation = light.elevation or 0.0
    season_day = _midnight(season, origin)
    days = (season_day + timedelta(days=way * k) for k in range(184) for way in (1, -1))
    first = next((d for d in days if sun_position(d, origin).elevation <= elevation), None)
    if first is None:
        raise InputError(
            f"condition {name!r}: the sun never sinks to {elevation:g} degrees at latitude "
            f"{origin.latitude:g}: choose another light or origin"
        )
    half_day = range(720) if light.rising else range(720, 1440)

    def error(minute: int) -> float:
        return abs(sun_position(first + timedelta(minutes=minute), origin).elevation - elevation)

    minute = min(half_day, key=error)
    return first + timedelta(minutes=minute), minute / 60


def _night_light(
    time: datetime, hour: float, weather: Weather, origin: Geodetic
) -> tuple[Sun, Sky, Night]:
    """Return the sun without power, the glow of the sky, and the lights of the night.

    Clouds hide the moon and reflect the lamps of the region.
    """
    azimuth, elevation = sun_position(time, origin)
    sun = Sun(azimuth, elevation, 0.53, 0.0, (1.0, 1.0, 1.0))
    watts = _MOON_W * (1 - 0.96 * weather.cloud)
    moon = Sun((azimuth + 180) % 360, _MOON_DEG, 0.53 + 14.0 * weather.cloud, watts, _MOON_RGB)
    zenith = _mix((0.22, 0.30, 0.52), (0.62, 0.50, 0.40), weather.cloud)
    horizon = _mix((0.62, 0.60, 0.66), (0.95, 0.72, 0.52), weather.cloud)
    sky = Sky(zenith, horizon, _GLOW * (1 + weather.cloud))
    hours, shares = zip(*_LIT_WINDOWS, strict=True)
    return sun, sky, Night(moon, float(np.interp(hour, hours, shares)))


def _sunlight(elevation: float) -> tuple[float, Rgb]:
    """Return the direct irradiance (W/m2 on Blender's scale) and the colour of a clear sun.

    The irradiance falls with the air mass (Kasten and Young, 1989) by Meinel's law 0.7^(AM^0.678).
    Blue and green fall faster than red.
    """
    mass = 1 / (sin(radians(elevation)) + 0.50572 * (elevation + 6.07995) ** -1.6364)
    return 6.15 * 0.7 ** (mass**0.678), (1.0, exp(-0.042 * mass), exp(-0.092 * mass))


def _sky(elevation: float, cloud: float) -> Sky:
    """Return the sky. It is darker and redder under a low sun, and grey under clouds."""
    day = min(1.0, max(0.0, (sin(radians(elevation)) - 0.15) / 0.7))
    zenith = _mix((0.20, 0.30, 0.52), (0.30, 0.44, 0.72), day)
    horizon = _mix((0.55, 0.56, 0.62), (0.72, 0.80, 0.88), day)
    zenith, horizon = (
        _mix(zenith, (0.62, 0.65, 0.70), cloud),
        _mix(horizon, (0.52, 0.55, 0.59), cloud),
    )
    return Sky(zenith, horizon, 0.5 + 0.85 * day)


def _exposure(sun: Sun, sky: Sky, season: Season, weather: Weather, night: Night | None) -> float:
    """Return the exposure in stops: 85 % of the value of a light meter that looks down from 100 m.

    Photographs in the evening therefore stay a little dark. Photographs at night are darker still,
    because a camera limits its exposure time and its gain.
    """
    light = sky.strength * (sum(sky.zenith) + sum(sky.horizon)) / 6
    albedo = 0.12 + 0.3 * season.snow
    if night is not None:
        street = albedo * (_STREET_W / pi + light)
        return 0.85 * log2(0.33 / street) - _NIGHT_UNDEREXPOSURE
    ground = albedo * (sun.watts * sin(radians(sun.elevation)) / pi + light)
    transmittance = exp(-3.912 * 100 / weather.visibility_m)
    return 0.85 * log2(0.33 / (transmittance * ground + (1 - transmittance) * light))


def _mix(a: Rgb, b: Rgb, share: float) -> Rgb:
    """Return ``a`` where ``share`` is 0, ``b`` where it is 1, and a linear mix between."""
    red, green, blue = (p + share * (q - p) for p, q in zip(a, b, strict=True))
    return red, green, blue
