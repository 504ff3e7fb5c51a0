"""Configurations: pydantic models read from YAML files and the command line."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import Any, Final, TypeVar

import yaml
from pydantic import BaseModel, ValidationError, field_validator

from objconnect.scene.errors import InputError
from objconnect.scene.storage.files import read_text
from objconnect.scene.storage.records import Record

_PACKAGES: Final = Path(__file__).resolve().parents[2]
SHIPPED: Final = {
    "": _PACKAGES / "simulate" / "configs",
    "train/": _PACKAGES / "objconnect" / "learning" / "configs",
}
"""The folders of the configurations that come with the project, by what their names begin with."""

LARGEST: Final = 2**31 - 1
"""The largest absolute value of a number in a configuration: seed, count, pixels, metres, ..."""


class Config(Record):
    """Base class of every configuration: immutable, and an unknown key is an error.

    So are infinite numbers and numbers beyond 31 bits and a sign, which libraries would truncate,
    or fail on after a long run.
    """

    @field_validator("*")
    @classmethod
    def _not_huge(cls, value: Any) -> Any:
        if isinstance(value, int | float) and abs(value) > LARGEST:
            raise ValueError(f"numbers here are at most {LARGEST}")
        if isinstance(value, tuple | list):
            for item in value:
                cls._not_huge(item)
        return value


def with_default(model: type[BaseModel], name: str, default: object) -> Any:
    """Return a field of a configuration with another default, for one that is derived from it.

    Example:
        >>> from pydantic import Field
        >>> class Training(Config):
        ...     steps: int = Field(1000, description="Steps of the optimizer.")
        >>> class QuickTraining(Training):
        ...     steps: int = with_default(Training, "steps", 10)
        >>> QuickTraining(), QuickTraining.model_fields["steps"].description
        (QuickTraining(steps=10), 'Steps of the optimizer.')
    """
    field = copy(model.model_fields[name])
    field.default = default
    return field


M = TypeVar("M", bound=BaseModel)


def load_config(model: type[M], path: Path | None, overrides: Mapping[str, Any]) -> M:
    """Build a configuration from a YAML file and overrides; other options have their defaults.

    Args:
        model: class of the configuration.
        path: YAML file, or the name of a configuration that comes with the project, for example
            ``demo`` or ``train/pixloc``; a file of that name has precedence. None for defaults.
        overrides: values with precedence over the file; ``outer.inner`` names a value of a nested
            configuration.

    Raises:
        InputError: the file is unreadable or not YAML, a key is unknown or a value is bad; the
            message names the key.

    Example:
        >>> class Options(Config):
        ...     steps: int = 1000
        ...     batch: int = 8
        >>> load_config(Options, None, {"batch": 4})
        Options(steps=1000, batch=4)
        >>> load_config(Options, None, {"bats": 4})
        Traceback (most recent call last):
        objconnect.scene.errors.InputError: unknown key 'bats' on the command line; known: ...
    """
    values: dict[str, Any] = {}
    where = "on the command line"
    if path is not None:
        path = _find_config(path)
        where = f"in {path}"
        text = _read(path)
        try:
            loaded = yaml.safe_load(text)
        # ValueError: a date that does not exist; RecursionError: lists nested very deeply.
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            raise InputError(f"{path} is not valid YAML: {_one_line(error)}") from None
        if loaded is not None and not isinstance(loaded, dict):
            raise InputError(f"{path} must hold 'key: value' lines, not a {type(loaded).__name__}")
        values = loaded or {}
    for key, value in overrides.items():
        _set_nested(values, key, value)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise InputError(describe(error, model, where)) from None


def take_recorded(model: type[BaseModel], values: Mapping[str, Any]) -> dict[str, Any]:
    """Take the fields of a configuration from what an earlier version recorded of it.

    What has become a constant since is left out. A field of a group that is no more has its own
    name, or that of the group before it.

    Example:
        >>> class Options(Config):
        ...     steps: int = 1000
        ...     loss_share: float = 0.5
        >>> take_recorded(Options, {"steps": 9, "decay": 0.1, "loss": {"share": 0.3}})
        {'steps': 9, 'loss_share': 0.3}
    """
    taken: dict[str, Any] = {}
    for key, value in values.items():
        field = model.model_fields.get(key)
        inner = field.annotation if field else None
        if isinstance(inner, type) and issubclass(inner, BaseModel) and isinstance(value, Mapping):
            taken[key] = take_recorded(inner, value)
        elif field is not None:
            taken[key] = value
        elif isinstance(value, Mapping):
            named = {f"{key}_{name}": of_group for name, of_group in value.items()}
            taken |= take_recorded(model, {**value, **named})
    return taken


def _set_nested(values: dict[str, Any], key: str, value: Any) -> None:
    """Set a value by its dotted key, and leave the other values of nested configurations."""
    *outer, last = key.split(".")
    for part in outer:
        inner = values.get(part)
        # Copied, so that dictionaries of the caller stay as they are.
        values[part] = dict(inner) if isinstance(inner, Mapping) else {}
        values = values[part]
    values[last] = value


def list_configs() -> dict[str, Path]:
    """Return the configurations that come with the project, by name.

    Those of ``simulate`` are called like their files, those of trainings ``train/NAME``.
    """
    return {
        begin + path.stem: path
        for begin, folder in SHIPPED.items()
        for path in sorted(folder.glob("*.yaml"))
    }


def _find_config(path: Path) -> Path:
    """Return the path if it is a file, else the configuration of this name that comes with the
    project."""
    return path if path.is_file() else list_configs().get(path.as_posix(), path)


def _read(path: Path) -> str:
    try:
        return read_text(path, "configuration")
    except InputError as error:
        if path.exists():
            raise
        raise InputError(f"{error}; by name there are: {', '.join(list_configs())}") from error


def describe(error: ValidationError, model: type[BaseModel], where: str) -> str:
    """Return the first fault of a validation error as one line that tells what to change."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"]) or model.__name__
    if first["type"] == "extra_forbidden":
        return f"unknown key '{key}' {where}{_list_keys(model, first['loc'][:-1])}"
    if first["type"] == "missing":
        return f"missing key '{key}' {where}"
    reason = first["msg"].removeprefix("Value error, ")  # pydantic's prefix of our messages
    return f"bad value for '{key}' {where}: {reason} (got {reprlib.repr(first['input'])})"


def _list_keys(model: type[BaseModel], path: Sequence[int | str]) -> str:
    """Return the known keys at a path of keys; an empty text where the path leads to no model."""
    for part in path:
        field = model.model_fields.get(str(part))
        inner = field.annotation if field else None
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return ""
        model = inner
    return f"; known: {', '.join(model.model_fields)}"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
