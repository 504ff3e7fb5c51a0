"""The options of a forecast that change its figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pydantic import Field, field_validator

from objconnect.scene.config import Config, load_config
from objconnect.scene.errors import InputError
from objconnect.scene.storage.records import Record
from simulate.look.conditions import condition

SEASONS = ("summer-noon", "winter-noon", "snow-dusk")
"""The conditions that are forecast when none are named."""


class ForecastConfig(Config):
    """A forecast: what is rendered, and how probabilities follow from it."""

    seasons: tuple[str, ...] = Field(
        SEASONS,
        min_length=1,
        description="Conditions that are forecast, SEASON-LIGHT[-WEATHER].",
    )
    views: int = Field(
        2, ge=1, le=50, description="Views that are rendered of each waypoint in each season."
    )
    size: int = Field(
        512,
        ge=64,
        le=4096,
        description="Longer side of the views, pixels; that of the map's photographs where they "
        "are smaller.",
    )
    seed: int = Field(
        0,
        ge=0,
        description="Random seed of the views' deviations, of their priors, and of the snow.",
    )
    start: str = Field(
        "prior", description="What the method is told about a view, as for ``evaluate``."
    )
    fix_m: float = Field(0.5, gt=0, description="A fix is wrong by less than this, metres.")
    fix_deg: float = Field(5.0, gt=0, description="And by less than this, degrees.")
    calibrated: bool = Field(
        True,
        description="Whether the probabilities are calibrated for the method, where the project "
        "has a calibration of it; otherwise they are the smoothed share of views that were found.",
    )
    weak: float = Field(
        0.5,
        gt=0,
        lt=1,
        description="Below this probability a waypoint belongs to a weak stretch.",
    )
    waypoints: int = Field(
        30, ge=1, description="Number of waypoints of a flight that is no mission plan."
    )
    gap_m: float = Field(
        100.0,
        gt=0,
        description="The longest way without a fix that the aircraft can fly, metres.",
    )

    @field_validator("seasons")
    @classmethod
    def _check_names(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        known = tuple(condition(name).name for name in names)
        if len(set(known)) < len(known):
            raise ValueError(f"a season is named twice: {', '.join(known)}")
        return known


_DEFAULTS: Final = ForecastConfig()
_PREFIX: Final = "forecast."


class _Settings(Record):
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
