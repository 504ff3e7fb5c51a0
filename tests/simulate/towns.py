"""Towns and other places that many tests share, because building one takes most of a second."""

from __future__ import annotations

from functools import cache

from simulate.place.presets import preset
from simulate.place.town import TOWN
from simulate.place.world import World


@cache
def cached_town(seed: int, side_m: float) -> World:
    """Return a town, built once in a process; no test changes it."""
    return TOWN.build(seed, side_m)


@cache
def cached_place(name: str, seed: int, side_m: float) -> World:
    """Return a place of a preset, built once in a process; no test changes it."""
    return preset(name)(seed, side_m)
