"""Bake the images of the ground of a place: albedo and specular share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulate.look import ground
from simulate.look.conditions import Condition
from simulate.look.cover import cover
from simulate.look.survey_albedo import bake_albedo, bake_specular
from simulate.place.world import World


class GroundImages(NamedTuple):
    """The baked images of the ground, row 0 in the south.

    Attributes:
        albedo: Albedo (n, n, 3) uint8 sRGB.
        specular: Specular share (n, n) uint8 of 255, which is 255 for water.
    """

    albedo: NDArray[np.uint8]
    specular: NDArray[np.uint8]


def bake_ground(world: World, condition: Condition) -> GroundImages:
    """Return the images of a place's ground under a condition: season, light and weather.

    The tiles of a tiled place are baked one by one, so that the ground of a tile looks the same
    beside any neighbours.
    """
    if world.imagery is not None:
        return GroundImages(bake_albedo(world, condition), bake_specular(world, condition))
    if world.tiles:
        baked = [[bake_ground(tile, condition) for tile in row] for row in world.tiles]
        return GroundImages(
            np.concatenate([np.concatenate([b.albedo for b in row], 1) for row in baked]),
            np.concatenate([np.concatenate([b.specular for b in row], 1) for row in baked]),
        )
    covered = cover(world, condition)
    return GroundImages(
        ground.bake(world.ground, condition, world.seed, covered),
        ground.specular_map(world.ground, condition, world.seed, covered),
    )
