from __future__ import annotations

import pytest

from baselines.registry import METHODS, create
from scene.errors import InputError


@pytest.mark.parametrize("name", METHODS)
def test_every_method_is_built_by_its_name(name: str) -> None:
    assert create(name, {}).name == name


def test_overrides_reach_the_configuration() -> None:
    assert create("sift", {"references": 3}).config.model_dump()["references"] == 3


def test_unknown_methods_and_keys_are_named() -> None:
    with pytest.raises(InputError, match="unknown method 'surf'; known: sift"):
        create("surf", {})
    with pytest.raises(InputError, match="unknown key 'reference' on the command line"):
        create("sift", {"reference": 3})
    with pytest.raises(InputError, match="bad value for 'ratio'"):
        create("sift", {"ratio": 2})
