"""Localizers by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, Final, cast

from scene.config import load_config
from scene.errors import InputError
from scene.localizer import Localizer

if TYPE_CHECKING:
    from baselines.training.config import TrainConfig
    from baselines.training.loop import Trainable

# Module, configuration and localizer of every method; a module is loaded when its method is made.
_MADE_OF: Final = {
    "sift": ("baselines.sift", "SiftConfig", "SiftLocalizer"),
    "orb": ("baselines.binary", "OrbConfig", "OrbLocalizer"),
    "akaze": ("baselines.binary", "AkazeConfig", "AkazeLocalizer"),
    "epipolar": ("baselines.epipolar", "EpipolarConfig", "EpipolarLocalizer"),
    "d2net": ("baselines.d2net.localizer", "D2NetConfig", "D2NetLocalizer"),
    "pixloc": ("baselines.pixloc.localizer", "PixlocConfig", "PixlocLocalizer"),
    "objconnect": ("objconnect.localizer", "ObjConnectConfig", "ObjConnectLocalizer"),
    "place": ("objconnect.place", "PlaceConfig", "PlaceLocalizer"),
    "prior": ("baselines.prior", "PriorConfig", "PriorLocalizer"),
}
METHODS: Final = tuple(_MADE_OF)
# Module and class of what those learn that can.
_TAUGHT_BY: Final = {
    "d2net": ("baselines.d2net.training", "D2NetTraining"),
    "pixloc": ("baselines.pixloc.training", "PixlocTraining"),
    "objconnect": ("objconnect.training", "ObjConnectTraining"),
}
TRAINABLE: Final = tuple(_TAUGHT_BY)
_PROTOCOL: Final = ("name", "config", "weights_sha256", "prepare", "localize")
ENTRY_POINTS: Final = "objconnect.localizers"


def known() -> list[str]:
    """Names of our methods, then of those that installed packages bring."""
    return [*METHODS, *sorted({found.name for found in entry_points(group=ENTRY_POINTS)})]


def create(name: str, overrides: Mapping[str, Any]) -> Localizer:
    """Build a localizer.

    A package brings its own by an entry point of the group ``objconnect.localizers``: a callable
    that takes the overrides and returns a ``scene.localizer.Localizer``.

    Args:
        name: one of ``known()``.
        overrides: configuration values that differ from the defaults.

    Raises:
        InputError: unknown name, unknown key or bad value, or a package that cannot be loaded.
    """
    if name in _MADE_OF:
        path, config, localizer = _MADE_OF[name]
        module = import_module(path)
        settings = load_config(getattr(module, config), None, overrides)
        return cast("Localizer", getattr(module, localizer)(settings))
    for found in entry_points(group=ENTRY_POINTS, name=name):
        return _brought(found, overrides)
    raise InputError(f"unknown method {name!r}; known: {', '.join(known())}")


def trainable(name: str) -> Callable[[TrainConfig], Trainable]:
    """A method that learns, still to be given the configuration of its training.

    Raises:
        InputError: no such method, or one without anything to learn.
    """
    if name in _TAUGHT_BY:
        path, teacher = _TAUGHT_BY[name]
        return cast("Callable[[TrainConfig], Trainable]", getattr(import_module(path), teacher))
    raise InputError(f"method {name!r} cannot be trained; those that can: {', '.join(TRAINABLE)}")


def _brought(found: EntryPoint, overrides: Mapping[str, Any]) -> Localizer:
    """A localizer of another package, whose faults are its own but must not be tracebacks."""
    try:
        localizer = found.load()(dict(overrides))
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"method {found.name!r} ({found.value}) cannot be made: {type(error).__name__}: {error}"
        ) from error
    lacking = [part for part in _PROTOCOL if not hasattr(localizer, part)]
    if lacking:
        raise InputError(
            f"method {found.name!r} ({found.value}) is no localizer: it lacks {', '.join(lacking)}"
        )
    return cast("Localizer", localizer)
