from __future__ import annotations

from pathlib import Path

import pytest

from objconnect.methods import METHODS, create
from objconnect.scene.errors import InputError
from tests.baselines.d2net.untrained import create_untrained


@pytest.mark.parametrize("name", METHODS)
def test_every_method_is_built_by_its_name(name: str, tmp_path: Path) -> None:
    overrides = {"weights": create_untrained(tmp_path)} if name == "d2net" else {}
    assert create(name, overrides).name == name


def test_overrides_reach_the_configuration() -> None:
    assert create("sift", {"references": 3}).config.model_dump()["references"] == 3


def test_unknown_methods_and_keys_are_named() -> None:
    with pytest.raises(InputError, match="unknown method 'surf'; known: sift"):
        create("surf", {})
    with pytest.raises(InputError, match="unknown key 'reference' on the command line"):
        create("sift", {"reference": 3})
    with pytest.raises(InputError, match="bad value for 'ratio'"):
        create("sift", {"ratio": 2})
