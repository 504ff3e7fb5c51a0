"""Localizers and methods that learn, by name.

The command line lists the names in its help, so that importing this module imports no method.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, cast

from objconnect.scene.errors import InputError
from objconnect.scene.registry import Lazy, Registry

if TYPE_CHECKING:
    from objconnect.learning.training.config import TrainConfig
    from objconnect.learning.training.loop import Trainable
    from objconnect.scene.localizer import Localizer

    LocalizerFactory = Callable[[Mapping[str, Any]], Localizer]
    """Builds a localizer from the configuration values that differ from its defaults."""


def _lazy_factory(module: str, config: str, localizer: str) -> LocalizerFactory:
    """Return a factory that imports the module of a method when it is called."""

    def make(overrides: Mapping[str, Any]) -> Localizer:
        from objconnect.scene.config import load_config

        loaded = import_module(module)
        settings = load_config(getattr(loaded, config), None, overrides)
        return cast("Localizer", getattr(loaded, localizer)(settings))

    return make


LOCALIZERS: Final[Registry[LocalizerFactory]] = Registry(
    "method",
    "objconnect.localizers",
    {
        "sift": _lazy_factory("baselines.sift", "SiftConfig", "SiftLocalizer"),
        "orb": _lazy_factory("baselines.binary", "OrbConfig", "OrbLocalizer"),
        "akaze": _lazy_factory("baselines.binary", "AkazeConfig", "AkazeLocalizer"),
        "epipolar": _lazy_factory("baselines.epipolar", "EpipolarConfig", "EpipolarLocalizer"),
        "d2net": _lazy_factory("baselines.d2net.localizer", "D2NetConfig", "D2NetLocalizer"),
        "pixloc": _lazy_factory("baselines.pixloc.localizer", "PixlocConfig", "PixlocLocalizer"),
        "pixloc-search": _lazy_factory(
            "baselines.pixloc.localizer", "PixlocSearchConfig", "PixlocSearchLocalizer"
        ),
        "objconnect": _lazy_factory(
            "objconnect.network.localizer", "ObjConnectConfig", "ObjConnectLocalizer"
        ),
        "place": _lazy_factory(
            "objconnect.network.coarse_localizer", "CoarseLocalizerConfig", "CoarseLocalizer"
        ),
        "prior": _lazy_factory("baselines.prior", "PriorConfig", "PriorLocalizer"),
    },
    unknown="unknown {kind} {name!r}; known: {names}",
)

TRAINABLES: Final[Registry[Callable[[TrainConfig], Trainable]]] = Registry(
    "method",
    "objconnect.trainables",
    {
        "d2net": Lazy("baselines.d2net.training:D2NetTraining"),
        "pixloc": Lazy("baselines.pixloc.training:PixlocTraining"),
        "objconnect": Lazy("objconnect.network.training:ObjConnectTraining"),
        "objects": Lazy("objconnect.network.object_training:ObjectTraining"),
    },
    unknown="{kind} {name!r} cannot be trained; those that can: {names}",
)

METHODS: Final = tuple(LOCALIZERS.built_in)
TRAINABLE: Final = tuple(TRAINABLES.built_in)
_PROTOCOL: Final = ("name", "config", "weights_sha256", "prepare", "localize")


def method_names() -> list[str]:
    """Return the names of our methods, then those of methods that installed packages add."""
    return list(LOCALIZERS)


def create(name: str, overrides: Mapping[str, Any]) -> Localizer:
    """Build a localizer.

    A package adds its own by an entry point of the group ``objconnect.localizers``: a callable
    that takes the overrides and returns a ``objconnect.scene.localizer.Localizer``.

    Args:
        name: one of ``known()``.
        overrides: configuration values that differ from the defaults.

    Raises:
        InputError: the name or a key is unknown, a value is bad, or a package's localizer cannot
            be built.
    """
    with LOCALIZERS.blame(name, "cannot be made"):
        localizer = LOCALIZERS.load(name, "cannot be made")(dict(overrides))
    entry_point = LOCALIZERS.entry_point(name)
    lacking = [part for part in _PROTOCOL if not hasattr(localizer, part)]
    if entry_point is not None and lacking:
        raise InputError(
            f"method {name!r} ({entry_point.value}) is no localizer: it lacks {', '.join(lacking)}"
        )
    return localizer


def trainable(name: str) -> Callable[[TrainConfig], Trainable]:
    """Return a method that learns; it is still to be given the configuration of its training.

    A package adds its own by an entry point of the group ``objconnect.trainables``: a callable
    that takes a ``objconnect.learning.training.config.TrainConfig`` and returns a
    ``objconnect.learning.training.loop.Trainable``.

    Raises:
        InputError: there is no such method, it has nothing to learn, or a package's cannot be
            loaded.
    """
    return TRAINABLES.load(name)
