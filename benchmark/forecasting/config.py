"""The options of a forecast that change its figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final

from pydantic import Field, field_validator

from objconnect.scene.config import Config, load_config
from objconnect.scene.errors import InputError
from simulate.look.conditions import condition

Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(gt=0, lt=1)]

SEASONS = ("summer-noon", "winter-noon", "snow-dusk")
"""The conditions that are forecast when none are named."""


class ForecastConfig(Config):
    """A forecast: what is rendered, and how probabilities follow from it.

    Attributes:
        seasons: conditions, SEASON-LIGHT[-WEATHER].
        views: views that are rendered of each waypoint in each season.
        size: longer side of the views, pixels; the map's photographs where they are smaller.
        seed: random seed of the views' deviations, of their priors, and of the snow.
        deviation_m: standard deviation of the views from the waypoint, per axis, metres.
        deviation_deg: standard deviation of their attitude, per axis, degrees.
        start: what the method is told about a view, as for ``evaluate``.
        fix_m: a fix is wrong by less than this, metres.
        fix_deg: and by less than this, degrees.
        pool_m: views of a neighbour at this distance count 61 % of a waypoint's own (a normal
            curve's one sigma), metres.
        calibrated: whether the probabilities are calibrated for the method, where the project has
            a calibration of it; otherwise they are the smoothed share of views that were found.
        few_points: with fewer points of the map in view, more photographs of the map would help.
        weak: below this probability a waypoint belongs to a weak stretch.
        waypoints: number of waypoints of a flight that is no mission plan.
        gap_m: the longest way without a fix that the aircraft can fly, metres.
        most_waypoints: a flight with more is refused, because it would take hours.
    """

    seasons: tuple[str, ...] = Field(SEASONS, min_length=1)
    views: int = Field(2, ge=1, le=50)
    size: int = Field(512, ge=64, le=4096)
    seed: int = Field(0, ge=0)
    deviation_m: float = Field(0.7, ge=0)
    deviation_deg: float = Field(1.5, ge=0, le=30)
    start: str = "prior"
    fix_m: Positive = 0.5
    fix_deg: Positive = 5.0
    pool_m: Positive = 20.0
    calibrated: bool = True
    few_points: int = Field(40, ge=1)
    weak: Share = 0.5
    waypoints: int = Field(30, ge=1)
    gap_m: Positive = 100.0
    most_waypoints: int = Field(300, ge=1)

    @field_validator("seasons")
    @classmethod
    def _known_and_once(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        known = tuple(condition(name).name for name in names)
        if len(set(known)) < len(known):
            raise ValueError(f"a season is named twice: {', '.join(known)}")
        return known


_DEFAULTS: Final = ForecastConfig()
_PREFIX: Final = "forecast."


class _Settings(Config):
    """What of the settings is of a forecast and not of its method."""

    forecast: ForecastConfig = _DEFAULTS


def forecast_config(settings: dict[str, Any], told: Mapping[str, Any]) -> ForecastConfig:
    """Take the settings of a forecast, ``forecast.KEY``, out of others.

    Args:
        settings: values by key; those of the forecast are removed.
        told: values of the forecast that options of their own give.

    Raises:
        InputError: a key of the forecast is unknown, its value is bad, or it has an option.
    """
    own = {key: settings.pop(key) for key in list(settings) if is_of_forecast(key)}
    for key in own:
        name = key.removeprefix(_PREFIX)
        if name == key:
            raise InputError(f"--set {key}: name one value, as {_PREFIX}size")
        if name in _OPTIONS:
            raise InputError(f"--set {key}: give {_OPTIONS[name]} instead")
    own |= {f"{_PREFIX}{key}": value for key, value in told.items()}
    return load_config(_Settings, None, own).forecast


# Values of a forecast that have an option.
_OPTIONS: Final = {"seasons": "--season", "views": "--views", "start": "--start"}


def is_of_forecast(key: str) -> bool:
    """Return whether a key of settings is one of the forecast's."""
    return key.partition(".")[0] == _PREFIX.rstrip(".")


def forecast_hint(settings: Mapping[str, Any]) -> str:
    """Return what to write where a setting of a method has the name of one of the forecast's."""
    named = [key for key in settings if key in ForecastConfig.model_fields]
    return f"; of the forecast it is --set {_PREFIX}{named[0]}=VALUE" if named else ""
