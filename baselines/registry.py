"""Localizers by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from scene.config import load_config
from scene.errors import InputError
from scene.localizer import Localizer

METHODS: Final = ("sift",)


def create(name: str, overrides: Mapping[str, Any]) -> Localizer:
    """Build a localizer.

    Args:
        name: one of ``METHODS``.
        overrides: configuration values that differ from the defaults.

    Raises:
        InputError: unknown name, unknown key or bad value.
    """
    if name == "sift":
        from baselines.sift import SiftConfig, SiftLocalizer

        return SiftLocalizer(load_config(SiftConfig, None, overrides))
    raise InputError(f"unknown method {name!r}; known: {', '.join(METHODS)}")
