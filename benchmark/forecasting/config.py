"""The options of a forecast."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pydantic import Field, field_validator

from objconnect.scene.config import Config, load_config
from objconnect.scene.errors import InputError
from objconnect.scene.storage.records import Record
from simulate.look.conditions import condition

SEASONS = ("summer-noon", "winter-noon", "snow-dusk")
"""The conditions that are forecast if none are named."""


class ForecastConfig(Config):
    """Options of a forecast: the views that it renders, and its computation of probabilities."""

    seasons: tuple[str, ...] = Field(
        SEASONS,
        min_length=1,
        description="Conditions to forecast, SEASON-LIGHT[-WEATHER].",
    )
    views: int = Field(
        2, ge=1, le=50, description="Number of views to render at each waypoint in each season."
    )
    size: int = Field(
        512,
        ge=64,
        le=4096,
        description="Longer side of the views, pixels; at most that of the map's photographs.",
    )
    seed: int = Field(
        0,
        ge=0,
        description="Random seed of the views' deviations from the waypoints, of their priors, "
        "and of the snow.",
    )
    start: str = Field(
        "prior", description="Information on each view for the method, as for ``evaluate``."
    )
    fix_m: float = Field(0.5, gt=0, description="Largest position error of a fix, metres.")
    fix_deg: float = Field(5.0, gt=0, description="Largest rotation error of a fix, degrees.")
    calibrated: bool = Field(
        True,
        description="Whether to calibrate the probabilities if there is a calibration for the "
        "method; otherwise they are the smoothed share of views with a fix.",
    )
    weak: float = Field(
        0.5,
        gt=0,
        lt=1,
        description="Probability of a fix below which a waypoint belongs to a weak stretch.",
    )
    waypoints: int = Field(
        30,
        ge=1,
        description="Number of waypoints, unless the flight defines it, as a mission plan does.",
    )
    gap_m: float = Field(
        100.0,
        gt=0,
        description="Longest distance that the aircraft can fly without a fix, metres.",
    )

    @field_validator("seasons")
    @classmethod
    def _check_names(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        conditions = tuple(condition(name).name for name in names)
        if len(set(conditions)) < len(conditions):
            raise ValueError(f"a season is named twice: {', '.join(conditions)}")
        return conditions


_DEFAULTS: Final = ForecastConfig()
_PREFIX: Final = "forecast."


class _Settings(Record):
    """The settings that belong to the forecast, not to the method."""

    forecast: ForecastConfig = _DEFAULTS


def forecast_config(settings: dict[str, Any], options: Mapping[str, Any]) -> ForecastConfig:
    """Remove the settings of the forecast, ``forecast.KEY``, from all settings and read them.

    Args:
        settings: values by key; those of the forecast are removed.
        options: values of the forecast that the command's own options give.

    Raises:
        InputError: a key of the forecast is unknown, its value is bad, or the command has an option
            for it.
    """
    forecast_settings = {key: settings.pop(key) for key in list(settings) if is_of_forecast(key)}
    for key in forecast_settings:
        name = key.removeprefix(_PREFIX)
        if name == key:
            raise InputError(f"--set {key}: set one option of the forecast, as {_PREFIX}size")
        if name in _OPTIONS:
            raise InputError(f"--set {key}: give {_OPTIONS[name]} instead")
    forecast_settings |= {f"{_PREFIX}{key}": value for key, value in options.items()}
    return load_config(_Settings, None, forecast_settings).forecast


# Fields for which the command has an option.
_OPTIONS: Final = {"seasons": "--season", "views": "--views", "start": "--start"}


def is_of_forecast(key: str) -> bool:
    """Return whether a key of the settings belongs to the forecast."""
    return key.partition(".")[0] == _PREFIX.rstrip(".")


def forecast_hint(settings: Mapping[str, Any]) -> str:
    """Return a hint for a setting that lacks the prefix of the forecast; empty if there is none."""
    named = [key for key in settings if key in ForecastConfig.model_fields]
    if not named:
        return ""
    option = _OPTIONS.get(named[0], f"--set {_PREFIX}{named[0]}=VALUE")
    return f"; the option of the forecast is {option}"
