"""Cover of the ground of a place: standing water, leaves, and how fast snow thaws.

All images have the raster of the place's ground, with row 0 in the south. A cover changes colours
and reflections, but not the geometry.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.labels import CLASSES
from simulate.look.conditions import Condition
from simulate.look.noise import noise
from simulate.place.paint import SHIFT, to_raster
from simulate.place.world import World

Float = NDArray[np.float32]

_CELL_M: Final = 0.25  # smallest side of a cell in which covers are computed
_FLOODED: Final = ("grass", "field", "path")  # classes of ground that a flood reaches
_SHORE_M: Final = 0.06  # depth at which standing water hides the ground
_LOWEST_SUN_DEG: Final = 10.0  # limits the shadows in which snow stays
_TALL_M: Final = 1.0  # height of objects in whose shadow snow stays
_LITTER_REACH: Final = 1.7  # radius of fallen leaves, relative to the crown's


class Cover(NamedTuple):
    """Cover of the ground, each an image (n, n); None if the place has none of it.

    Attributes:
        flood: Share of standing water, 0 to 1.
        shelter: How well snow is sheltered from thaw, about -1 to 1.
        litter: Coverage by fallen leaves, 0 to 1.
    """

    flood: Float | None = None
    shelter: Float | None = None
    litter: Float | None = None


NO_COVER: Final = Cover()


def cover(world: World, condition: Condition) -> Cover:
    """Return the cover of the ground of a place under a condition."""
    return Cover(
        flood=_flood(world, condition),
        shelter=_shelter(world, condition),
        litter=_litter(world, condition),
    )


def _flood(world: World, condition: Condition) -> Float | None:
    """Return the share (n, n), 0 to 1, of standing water; None without a flood.

    The water has one level. It covers the lowest part of the open ground, whose share the weather
    states. In a tile, the level is computed from the heights of all ground of the whole place.
    """
    if condition.weather.flood == 0:
        return None
    labels = world.ground.labels
    n = len(labels)
    is_open = np.isin(labels, [CLASSES[name] for name in _FLOODED])
    if not is_open.any():
        return np.zeros((n, n), np.float32)
    height = _resize(_heights(world), n)
    sample = height[is_open][::97] if world.land_heights is None else world.land_heights
    level = float(np.quantile(sample, condition.weather.flood))
    rng = np.random.default_rng([world.seed, 5])
    rough = 0.08 * noise(rng, n, n * world.ground.texel_m / 6.0)
    return np.asarray(np.clip((level - height + rough) / _SHORE_M, 0, 1) * is_open)


def _shelter(world: World, condition: Condition) -> Float | None:
    """Return how well snow is sheltered from thaw, (n, n) from about -1 to 1; None without thaw.

    Snow stays in the shadows at noon, in hollows, and on slopes that face away from the sun.
    """
    if condition.season.thaw == 0 or condition.season.snow == 0:
        return None
    height = _heights(world)
    n = len(height)
    cell = len(world.ground.labels) * world.ground.texel_m / n
    azimuth, elevation = np.radians([condition.noon.azimuth, condition.noon.elevation])
    away = -np.array([np.sin(azimuth), np.cos(azimuth)])
    length = 1 / np.tan(max(elevation, np.radians(_LOWEST_SUN_DEG)))
    shade = np.zeros((n, n), np.uint8)
    for item in world.objects:
        if item.height_m > _TALL_M:
            foot = item.footprint()
            corners = np.concatenate([foot, foot + item.height_m * length * away])
            outline = cv2.convexHull(corners.astype(np.float32))[:, 0].astype(float)
            cv2.fillPoly(shade, [to_raster(outline, cell, n)], 255, cv2.LINE_AA, SHIFT)
    soft = cv2.GaussianBlur(shade, (0, 0), 0.7 / cell).astype(np.float32) / 255
    north, east = np.gradient(height, cell)
    facing = east * away[0] + north * away[1]  # negative where the ground falls away from the sun
    land = height if world.land_heights is None else world.land_heights
    low = (land.mean() - height) / max(float(land.std()), 0.1)
    shelter = 0.9 * soft + 0.15 * np.clip(low, -2, 2) - 4.0 * np.clip(facing, -0.1, 0.1)
    return _resize(shelter, len(world.ground.labels))


def _litter(world: World, condition: Condition) -> Float | None:
    """Return the coverage (n, n), 0 to 1, by fallen leaves; None if the season has none.

    Leaves lie under broadleaved trees and, fewer, all around them.
    """
    if condition.season.litter == 0:
        return None
    n = _cells(world)
    cell = len(world.ground.labels) * world.ground.texel_m / n
    under = np.zeros((n, n), np.uint8)
    for item in world.objects:
        if item.shape.startswith("broadleaf_"):
            (at,) = to_raster(item.centre[None, :2], cell, n)
            radius = round(_LITTER_REACH * 0.5 * item.size[0] / cell * (1 << SHIFT))
            cv2.circle(under, tuple(map(int, at)), radius, 255, -1, cv2.LINE_AA, SHIFT)
    near = cv2.GaussianBlur(under, (0, 0), 0.8 / cell).astype(np.float32)
    far = cv2.GaussianBlur(under, (0, 0), 5.0 / cell).astype(np.float32)
    share = condition.season.litter * np.maximum(near, 0.45 * far) / 255
    return _resize(share, len(world.ground.labels))


def _cells(world: World) -> int:
    """Return the number of cells per side in which covers are computed."""
    n = len(world.ground.labels)
    return min(n, max(2, round(n * world.ground.texel_m / _CELL_M)))


def _heights(world: World) -> Float:
    """Return the height (cells, cells) of the ground below objects, metres."""
    n = _cells(world)
    cell = len(world.ground.labels) * world.ground.texel_m / n
    axis = (np.arange(n) + 0.5 - 0.5 * n) * cell
    rows = [world.flight_ground.height(axis, np.full(n, y)) for y in axis]
    return np.asarray(rows, np.float32)


def _resize(cells: Float, n: int) -> Float:
    return np.asarray(cv2.resize(cells, (n, n), interpolation=cv2.INTER_LINEAR), np.float32)
