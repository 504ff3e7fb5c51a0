"""Conditions: a season, a light and, optionally, a weather, as in "autumn-dusk-fog".

A condition determines the appearance of a place and the time of a flight. It does not change the
geometry of a place; ``simulate.place.change`` does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from functools import cache
from math import exp, inf, log2, pi, radians, sin
from typing import TypeVar

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.registry import Registry
from simulate.look.sun import sun_position
from simulate.place.world import Rgb

PLACE = Geodetic(47.0, 8.0, 450.0)
"""The default geodetic origin of places."""

# Linear albedo of each kind of ground: (fresh, worn).
_SUMMER_GROUND: dict[str, tuple[Rgb, Rgb]] = {
    "grass": ((0.066, 0.092, 0.034), (0.150, 0.140, 0.075)),
    "field": ((0.105, 0.125, 0.040), (0.260, 0.205, 0.100)),
    "road": ((0.085, 0.085, 0.088), (0.125, 0.122, 0.118)),
    "pavement": ((0.240, 0.230, 0.215), (0.300, 0.285, 0.265)),
    "parking": ((0.100, 0.100, 0.103), (0.150, 0.147, 0.142)),
    "driveway": ((0.210, 0.190, 0.170), (0.260, 0.215, 0.185)),
    "path": ((0.270, 0.225, 0.165), (0.320, 0.280, 0.220)),
}
_WINTER_GROUND: dict[str, tuple[Rgb, Rgb]] = {
    "grass": ((0.080, 0.085, 0.042), (0.135, 0.115, 0.070)),
    "field": ((0.105, 0.085, 0.060), (0.155, 0.125, 0.085)),
    "road": ((0.070, 0.071, 0.075), (0.115, 0.113, 0.112)),
    "pavement": ((0.170, 0.168, 0.165), (0.220, 0.215, 0.208)),
    "parking": ((0.078, 0.079, 0.082), (0.125, 0.123, 0.121)),
    "driveway": ((0.150, 0.140, 0.130), (0.185, 0.160, 0.142)),
    "path": ((0.180, 0.155, 0.120), (0.220, 0.195, 0.160)),
}
_SPRING_GROUND = _SUMMER_GROUND | {
    "grass": ((0.052, 0.098, 0.026), (0.090, 0.120, 0.042)),
    "field": ((0.050, 0.095, 0.026), (0.150, 0.110, 0.070)),
}
_AUTUMN_GROUND = _SUMMER_GROUND | {
    "grass": ((0.078, 0.086, 0.034), (0.165, 0.120, 0.056)),
    "field": ((0.098, 0.072, 0.048), (0.170, 0.130, 0.082)),
}


@dataclass(frozen=True)
class Season:
    """A season: the day of the year, the colours of ground and leaves, and the snow.

    Attributes:
        day: Month and day in the northern hemisphere. In the southern hemisphere the season is half
            a year later.
        ground: Linear albedo (fresh, worn) by class of ground.
        leaf: Linear colour of the inner leaves of broadleaved trees.
        leaf_tip: Linear colour of their outer leaves.
        snow: Fraction of open ground under snow, 0 to 1.
        bare: Whether broadleaved trees have no leaves, a change of the geometry that sessions
            declare.
    """

    day: date
    ground: Mapping[str, tuple[Rgb, Rgb]]
    leaf: Rgb
    leaf_tip: Rgb
    snow: float = 0.0
    bare: bool = False


_BROWN_LEAF: Rgb = (0.042, 0.036, 0.024)
_BROWN_TIP: Rgb = (0.130, 0.105, 0.068)
SUMMER_LEAF: tuple[Rgb, Rgb] = (0.028, 0.046, 0.016), (0.120, 0.150, 0.050)
"""Linear colours of the inner and outer leaves in summer, and of conifers all year."""

_SEASONS: dict[str, Season] = {
    "spring": Season(
        date(2026, 4, 28),
        _SPRING_GROUND,
        leaf=(0.040, 0.066, 0.014),
        leaf_tip=(0.170, 0.215, 0.050),
    ),
    "summer": Season(date(2025, 7, 2), _SUMMER_GROUND, *SUMMER_LEAF),
    "autumn": Season(
        date(2025, 10, 20),
        _AUTUMN_GROUND,
        leaf=(0.085, 0.042, 0.012),
        leaf_tip=(0.330, 0.170, 0.030),
    ),
    "leafoff": Season(date(2025, 12, 3), _WINTER_GROUND, _BROWN_LEAF, _BROWN_TIP, bare=True),
    "winter": Season(date(2026, 1, 20), _WINTER_GROUND, _BROWN_LEAF, _BROWN_TIP, snow=0.62),
    "snow": Season(date(2026, 2, 6), _WINTER_GROUND, _BROWN_LEAF, _BROWN_TIP, snow=0.95),
}
SEASONS = Registry("season", "objconnect.seasons", _SEASONS, lambda e: isinstance(e, Season))


@dataclass(frozen=True)
class Light:
    """A time of day.

    Attributes:
        elevation: Elevation of the sun, degrees. None is half an hour before solar noon.
        rising: Whether that elevation is in the morning, else in the afternoon.
    """

    elevation: float | None
    rising: bool = False


_LIGHTS: dict[str, Light] = {
    "morning": Light(25.0, rising=True),
    "noon": Light(None),
    "afternoon": Light(35.0),
    "dusk": Light(10.0),
}
LIGHTS = Registry("light", "objconnect.lights", _LIGHTS, lambda e: isinstance(e, Light))
# Where the sun does not reach a light's elevation, this share of its highest elevation is used.
_SHARE_OF_HIGHEST = 0.6
_LOWEST_NOON = 3.0


@dataclass(frozen=True)
class Weather:
    """The weather: clouds, fog and rain.

    Attributes:
        cloud: Cloud cover, 0 to 1. It turns the sky grey, and dims and softens the sun.
        visibility_m: Distance in metres at which fog leaves 2 % of the contrast (Koschmieder).
        wet: Wetness, 0 to 1. It darkens surfaces, and puts a film of water and puddles on sealed
            ground.
    """

    cloud: float = 0.0
    visibility_m: float = inf
    wet: float = 0.0


_WEATHER: dict[str, Weather] = {
    "clear": Weather(),
    "overcast": Weather(cloud=1.0),
    "fog": Weather(cloud=1.0, visibility_m=800.0),
    "wet": Weather(wet=1.0),
}
WEATHER = Registry("weather", "objconnect.weather", _WEATHER, lambda e: isinstance(e, Weather))


@dataclass(frozen=True)
class Sun:
    """The sun at a time.

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
class Condition:
    """A season, a light and a weather over a place.

    Attributes:
        name: SEASON-LIGHT[-WEATHER].
        time: Start of flights under the condition.
        sun: The sun at that time, through the clouds.
        sky: The sky at that time.
        exposure: Exposure of the photographs, stops.
    """

    name: str
    time: datetime
    season: Season
    weather: Weather
    sun: Sun
    sky: Sky
    exposure: float


@cache
def condition(name: str, place: Geodetic = PLACE) -> Condition:
    """Return the condition SEASON-LIGHT[-WEATHER] at a place; the default weather is clear.

    Raises:
        InputError: a part of the name is unknown, or the sun does not rise that day at that
            latitude.
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

    time = _time(name, season, light, place)
    azimuth, elevation = sun_position(time, place)
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
        exposure=_exposure(sun, sky, season, weather),
    )


T = TypeVar("T")


def _part(known: Registry[T], word: str, kind: str, name: str) -> T:
    if word not in known:
        raise InputError(
            f"unknown condition {name!r}: no {kind} {word!r}, choose one of {', '.join(known)}"
        )
    return known[word]


def _time(name: str, season: Season, light: Light, place: Geodetic) -> datetime:
    """Return the UTC minute of the season's day at which the sun matches the light."""
    day = season.day if place.latitude >= 0 else season.day + timedelta(days=182)
    midnight = datetime(day.year, day.month, day.day, tzinfo=UTC)
    first = midnight - timedelta(minutes=round(place.longitude * 4))  # midnight of mean solar time
    minutes = [first + timedelta(minutes=k) for k in range(1440)]
    height = [sun_position(minute, place).elevation for minute in minutes]
    top = max(range(1440), key=height.__getitem__)
    if height[top] < _LOWEST_NOON:
        raise InputError(
            f"condition {name!r} has no daylight at latitude {place.latitude:g} on {day}: choose "
            "another season or origin"
        )
    if light.elevation is None:
        return minutes[top - 30]  # before noon, so that shadows do not lie due north
    wanted = min(light.elevation, _SHARE_OF_HIGHEST * height[top])
    side = range(top) if light.rising else range(top, 1440)
    return minutes[min(side, key=lambda k: abs(height[k] - wanted))]


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


def _exposure(sun: Sun, sky: Sky, season: Season, weather: Weather) -> float:
    """Return the exposure in stops: 85 % of that of a light meter at 100 m that points down.

    Photographs in the evening therefore stay a little dark.
    """
    light = sky.strength * (sum(sky.zenith) + sum(sky.horizon)) / 6
    albedo = 0.12 + 0.3 * season.snow
    ground = albedo * (sun.watts * sin(radians(sun.elevation)) / pi + light)
    through = exp(-3.912 * 100 / weather.visibility_m)
    return 0.85 * log2(0.33 / (through * ground + (1 - through) * light))


def _mix(a: Rgb, b: Rgb, share: float) -> Rgb:
    """Return ``a`` where ``share`` is 0, ``b`` where it is 1, and a linear mix between."""
    red, green, blue = (p + share * (q - p) for p, q in zip(a, b, strict=True))
    return red, green, blue
