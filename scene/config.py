"""Configuration: pydantic models from YAML and from the command line; unknown keys are errors."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from scene.errors import InputError
from scene.storage.files import read_text

SHIPPED: Final = Path(__file__).resolve().parents[1] / "configs"
"""Where the configurations lie that come with the project."""

LARGEST: Final = 2**31 - 1
"""Of the numbers in a configuration, either way: seeds, counts, pixels, metres, seconds."""


class Config(BaseModel):
    """Base of every configuration: immutable, and an unknown key is an error.

    So are numbers that nothing here has: infinite ones, and those that do not fit into 31 bits and
    a sign, which libraries cut off, or fail on when the work has long begun.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*")
    @classmethod
    def _not_huge(cls, value: Any) -> Any:
        if isinstance(value, int | float) and abs(value) > LARGEST:
            raise ValueError(f"numbers here are at most {LARGEST}")
        if isinstance(value, tuple | list):
            for item in value:
                cls._not_huge(item)
        return value


M = TypeVar("M", bound=BaseModel)


def load_config(model: type[M], path: Path | None, overrides: Mapping[str, Any]) -> M:
    """Build a configuration from a YAML file, then from overrides, then from its defaults.

    Args:
        model: the configuration's class.
        path: YAML file, or the name of a configuration that comes with the project, as ``demo`` or
            ``train/pixloc``; a file of that name wins. None for defaults.
        overrides: values that win over the file, by key; ``outer.inner`` names a value of a nested
            configuration. None values are ignored.

    Raises:
        InputError: unreadable file, bad YAML, unknown key or bad value; the message names the key.
    """
    values: dict[str, Any] = {}
    where = "on the command line"
    if path is not None:
        path = _named(path)
        where = f"in {path}"
        text = _read(path)
        try:
            loaded = yaml.safe_load(text)
        # ValueError: a date that does not exist; RecursionError: lists in lists in lists.
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            raise InputError(f"{path} is not valid YAML: {_one_line(error)}") from None
        if loaded is not None and not isinstance(loaded, dict):
            raise InputError(f"{path} must hold 'key: value' lines, not a {type(loaded).__name__}")
        values = loaded or {}
    for key, value in overrides.items():
        if value is not None:
            _set_nested(values, key, value)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise InputError(describe(error, model, where)) from None


def _set_nested(values: dict[str, Any], key: str, value: Any) -> None:
    """Set a value by its dotted key, and leave the other values of nested configurations."""
    *outer, last = key.split(".")
    for part in outer:
        inner = values.get(part)
        # Copied, so that dictionaries of the caller stay as they are.
        values[part] = dict(inner) if isinstance(inner, Mapping) else {}
        values = values[part]
    values[last] = value


def shipped() -> dict[str, Path]:
    """The configurations that come with the project, by name: their path below ``configs/``,
    without its ending."""
    files = sorted(SHIPPED.rglob("*.yaml"))
    return {path.relative_to(SHIPPED).with_suffix("").as_posix(): path for path in files}


def _named(path: Path) -> Path:
    """The file that a path leads to, else the configuration that comes under this name."""
    return path if path.is_file() else shipped().get(path.as_posix(), path)


def _read(path: Path) -> str:
    try:
        return read_text(path, "configuration")
    except InputError as error:
        if path.exists():
            raise
        raise InputError(f"{error}; by name there are: {', '.join(shipped())}") from error


def describe(error: ValidationError, model: type[BaseModel], where: str) -> str:
    """The first fault of a validation error as one line a person can act on."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"]) or model.__name__
    if first["type"] == "extra_forbidden":
        return f"unknown key '{key}' {where}{_known(model, first['loc'][:-1])}"
    if first["type"] == "missing":
        return f"missing key '{key}' {where}"
    reason = first["msg"].removeprefix("Value error, ")  # pydantic's own words before ours
    return f"bad value for '{key}' {where}: {reason} (got {reprlib.repr(first['input'])})"


def _known(model: type[BaseModel], path: Sequence[int | str]) -> str:
    """The keys of the model that a path of keys leads to; nothing where that is no model."""
    for part in path:
        field = model.model_fields.get(str(part))
        inner = field.annotation if field else None
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return ""
        model = inner
    return f"; known: {', '.join(model.model_fields)}"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
