"""Configurations: pydantic models filled from YAML files and command line options."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import Any, Final, TypeVar

import yaml
from pydantic import BaseModel, ValidationError, ValidationInfo, field_validator

from objconnect.scene.errors import InputError
from objconnect.scene.storage.files import read_text
from objconnect.scene.storage.records import Record

_PACKAGES: Final = Path(__file__).resolve().parents[2]
SHIPPED_CONFIGS: Final = {
    "": _PACKAGES / "simulate" / "configs",
    "train/": _PACKAGES / "objconnect" / "learning" / "configs",
}
"""Folders of the configurations that come with the project, by the prefix of their names."""

MAX_NUMBER: Final = 2**31 - 1
"""Largest absolute value of a number in a configuration."""


class Config(Record):
    """Base class of every configuration; instances are immutable.

    Unknown keys, infinite numbers and numbers beyond ``MAX_NUMBER`` are errors: libraries would
    truncate such numbers, or fail on them after a long run. A field may state a larger bound.
    """

    @field_validator("*")
    @classmethod
    def _not_huge(cls, value: Any, info: ValidationInfo) -> Any:
        bounds = cls.model_fields[info.field_name or ""].metadata
        _refuse_huge(value, max([MAX_NUMBER, *(getattr(bound, "le", 0) for bound in bounds)]))
        return value


def _refuse_huge(value: Any, maximum: float) -> None:
    if isinstance(value, int | float) and abs(value) > maximum:
        raise ValueError(f"the absolute value of the number must be at most {maximum}")
    if isinstance(value, tuple | list):
        for item in value:
            _refuse_huge(item, maximum)


def with_default(model: type[BaseModel], name: str, default: object) -> Any:
    """Return a configuration's field with another default, for a derived class.

    Examples:
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


class _Loader(yaml.SafeLoader):
    """The safe loader of YAML, which also refuses a key that is given twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            # A mapping may have several merge keys (<<). Other keys of a configuration are scalars.
            if key.tag == "tag:yaml.org,2002:merge" or not isinstance(key, yaml.ScalarNode):
                continue
            if key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key.value!r} is given twice", key.start_mark
                )
            seen.add(key.value)
        return super().construct_mapping(node, deep)


M = TypeVar("M", bound=BaseModel)


def load_config(model: type[M], path: Path | None, overrides: Mapping[str, Any]) -> M:
    """Build a configuration from a YAML file and overrides; other fields keep their defaults.

    Args:
        model: class of the configuration.
        path: YAML file, or the name of a shipped configuration such as ``demo`` or
            ``train/pixloc`` if no such file exists. None reads no file.
        overrides: values that replace those of the file; ``outer.inner`` names a nested field.

    Raises:
        InputError: the file is unreadable or not YAML, a key is unknown or a value is invalid.

    Examples:
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
            loaded = yaml.load(text, _Loader)
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
    """Return the values of a recorded configuration that the present class still has.

    Fields that the class lacks are dropped. Fields of a group that the class no longer has are
    taken as ``group_field`` or ``field``, whichever the class has.

    Examples:
        >>> class Options(Config):
        ...     steps: int = 1000
        ...     loss_share: float = 0.5
        >>> take_recorded(Options, {"steps": 9, "decay": 0.1, "loss": {"share": 0.3}})
        {'steps': 9, 'loss_share': 0.3}
    """
    fields: dict[str, Any] = {}
    for key, value in values.items():
        field = model.model_fields.get(key)
        inner = field.annotation if field else None
        if isinstance(inner, type) and issubclass(inner, BaseModel) and isinstance(value, Mapping):
            fields[key] = take_recorded(inner, value)
        elif field is not None:
            fields[key] = value
        elif isinstance(value, Mapping):
            prefixed = {f"{key}_{name}": item for name, item in value.items()}
            fields |= take_recorded(model, {**value, **prefixed})
    return fields


def _set_nested(values: dict[str, Any], key: str, value: Any) -> None:
    """Set a value by its dotted key; sibling values stay."""
    *outer, last = key.split(".")
    for part in outer:
        inner = values.get(part)
        # Copy, so that the caller's dictionaries do not change.
        values[part] = dict(inner) if isinstance(inner, Mapping) else {}
        values = values[part]
    values[last] = value


def list_configs() -> dict[str, Path]:
    """Return the paths of the shipped configurations by name, such as ``train/pixloc``."""
    return {
        prefix + path.stem: path
        for prefix, folder in SHIPPED_CONFIGS.items()
        for path in sorted(folder.glob("*.yaml"))
    }


def _find_config(path: Path) -> Path:
    """Return the path if it is a file, else the shipped configuration of this name."""
    return path if path.is_file() else list_configs().get(path.as_posix(), path)


def _read(path: Path) -> str:
    try:
        return read_text(path, "configuration")
    except InputError as error:
        if path.exists():
            raise
        raise InputError(f"{error}; shipped names are {', '.join(list_configs())}") from error


def describe(error: ValidationError, model: type[BaseModel], where: str) -> str:
    """Return the first error of a validation as one line that names the key.

    Unknown keys come before missing ones, because the known key may be misspelt.
    """
    first = min(error.errors(), key=lambda each: each["type"] != "extra_forbidden")
    key = ".".join(str(part) for part in first["loc"]) or model.__name__
    if first["type"] == "extra_forbidden":
        return f"unknown key '{key}' {where}{_list_keys(model, first['loc'][:-1])}"
    if first["type"] == "missing":
        return f"missing key '{key}' {where}"
    reason = first["msg"].removeprefix("Value error, ")  # pydantic adds this to our messages
    return f"bad value for '{key}' {where}: {reason} (got {reprlib.repr(first['input'])})"


def _list_keys(model: type[BaseModel], path: Sequence[int | str]) -> str:
    """Return a phrase with the known keys at a path of keys; empty if no model is there."""
    for part in path:
        field = model.model_fields.get(str(part))
        inner = field.annotation if field else None
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return ""
        model = inner
    return f"; known: {', '.join(model.model_fields)}"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
