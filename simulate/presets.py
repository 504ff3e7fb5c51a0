"""The places that can be built, by name."""

from __future__ import annotations

from collections.abc import Callable

from scene.errors import InputError
from simulate.town import build_town
from simulate.world import World

PRESETS: dict[str, Callable[[int, float], World]] = {"town": build_town}
"""Each makes a World of a seed and a side in metres."""


def preset(name: str) -> Callable[[int, float], World]:
    """The preset called `name`; InputError naming the valid ones when there is none."""
    try:
        return PRESETS[name]
    except KeyError:
        raise InputError(f"unknown preset {name!r}: choose one of {', '.join(PRESETS)}") from None
