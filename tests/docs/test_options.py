"""Options are few and described: of all configurations together, and of each method."""

from __future__ import annotations

from collections import Counter
from importlib import import_module
from pkgutil import walk_packages
from typing import Final

import pytest

from objconnect.methods import METHODS, create
from objconnect.scene.config import Config

PACKAGES: Final = ("objconnect", "simulate", "baselines", "benchmark")
MOST: Final = 323
"""Fields of all configurations. A new one is worth it where somebody sets it; lower this number
with every one that goes."""
MOST_OF_A_METHOD: Final = 15


def _list_derived(config: type[Config]) -> set[type[Config]]:
    found = {each for each in config.__subclasses__() if each.__module__.startswith(PACKAGES)}
    return found.union(*map(_list_derived, found))


@pytest.fixture(scope="module")
def configs() -> set[type[Config]]:
    for package in PACKAGES:
        for module in walk_packages(import_module(package).__path__, f"{package}."):
            if not module.name.startswith("simulate.render") and "__main__" not in module.name:
                import_module(module.name)
    return _list_derived(Config)


def test_there_are_no_more_options(configs: set[type[Config]]) -> None:
    own = [
        f"{config.__qualname__}.{name}"
        for config in configs
        for name in config.model_fields
        if name in config.__annotations__
    ]
    assert len(own) <= MOST


def test_every_option_is_described_where_it_is_defined(configs: set[type[Config]]) -> None:
    silent = {
        f"{config.__qualname__}.{name}"
        for config in configs
        for name, field in config.model_fields.items()
        if not field.description
    }
    listed = {config.__qualname__ for config in configs if "Attributes:" in (config.__doc__ or "")}
    assert not silent | listed, "say it in Field(description=...) alone"


def test_every_configuration_has_a_name_of_its_own(configs: set[type[Config]]) -> None:
    names = Counter(config.__qualname__ for config in configs)
    assert not [name for name, count in names.items() if count > 1]


@pytest.mark.parametrize("method", METHODS)
def test_a_method_has_few_options(method: str) -> None:
    """Those that the error of an unknown one lists; what few change lies in groups below."""
    assert len(type(create(method, {}).config).model_fields) <= MOST_OF_A_METHOD
