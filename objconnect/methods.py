"""Registries of localizers and of methods that can be trained, by name.

Importing this module imports no method, so that the command line's help, which lists the names, is
quick.
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
    from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
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
        "aliked+lightglue": _lazy_factory(
            "baselines.lightglue.localizer", "AlikedLightGlueConfig", "AlikedLightGlueLocalizer"
        ),
        "disk+lightglue": _lazy_factory(
            "baselines.lightglue.localizer", "DiskLightGlueConfig", "DiskLightGlueLocalizer"
        ),
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
    unknown_message="unknown {kind} {name!r}; known: {names}",
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
    unknown_message="{kind} {name!r} cannot be trained; those that can: {names}",
)

METHODS: Final = tuple(LOCALIZERS.built_in)
"""Names of the localizers of this package."""
TRAINABLE: Final = tuple(TRAINABLES.built_in)
"""Names of the methods of this package that can be trained."""
# Members of the protocol ``Localizer``.
_MEMBERS: Final = ("name", "config", "weights_sha256", "prepare", "localize")


def method_names() -> list[str]:
    """Return the names of the built-in methods, then those that installed packages add."""
    return list(LOCALIZERS)


def create(name: str, overrides: Mapping[str, Any]) -> Localizer:
    """Build a localizer.

    A package adds a localizer by an entry point of the group ``objconnect.localizers``: a callable
    that takes the overrides and returns an ``objconnect.scene.localizer.Localizer``.

    Args:
        name: one of ``method_names()``.
        overrides: configuration values that differ from the defaults.

    Raises:
        InputError: the name or a key is unknown, a value is invalid, or a package's localizer
            cannot be built.
    """
    with LOCALIZERS.convert_errors(name, "cannot be made"):
        localizer = LOCALIZERS.load(name, "cannot be made")(dict(overrides))
    _give_matcher(localizer)
    entry_point = LOCALIZERS.entry_point(name)
    # Built-in localizers are not checked: access to the members would load weights.
    if entry_point is None:
        return localizer
    if missing := [member for member in _MEMBERS if not hasattr(localizer, member)]:
        raise InputError(
            f"method {name!r} ({entry_point.value}) is not a localizer: "
            f"it lacks {', '.join(missing)}"
        )
    return localizer


def _give_matcher(localizer: Localizer) -> None:
    """Give a localizer that aligns features the matcher that ``search.matcher`` names."""
    search = getattr(getattr(localizer, "config", None), "search", None)
    matcher = getattr(search, "matcher", None)
    if matcher is None or not hasattr(localizer, "matched_finder"):
        return
    from objconnect.localization.featuremetric.matched_finder import MatchedFinder

    try:
        options = {key: value for key, value in matcher.items() if key != "method"}
        other = create(matcher["method"], options)
    except InputError as error:
        raise InputError(f"search.matcher: {error}") from error
    cast("FeaturemetricLocalizer", localizer).matched_finder = MatchedFinder(other)


def trainable(name: str) -> Callable[[TrainConfig], Trainable]:
    """Return the constructor of a method that can be trained; it takes a training configuration.

    A package adds a method by an entry point of the group ``objconnect.trainables``: a callable
    that takes an ``objconnect.learning.training.config.TrainConfig`` and returns an
    ``objconnect.learning.training.loop.Trainable``.

    Raises:
        InputError: there is no such method, it cannot be trained, or a package's method cannot be
            loaded.
    """
    return TRAINABLES.load(name)
