"""Find shaded points of a place, now and at the past hours that warmed its surfaces.

Terrain and objects are heights on a grid. A point is in the shade if the grid towards the sun rises
above the ray to the sun. Shade maps hold the height up to which the shade reaches in each cell.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from simulate.place.world import World, WorldObject

Float = NDArray[np.float32]
Array = NDArray[np.float64]

_MIN_CELL_M: Final = 0.4
_MAX_CELLS: Final = 1200  # per side
_OUTSIDE_M: Final = -1e4  # height beyond the place, where nothing gives shade
# Classes whose shade is ignored, because they are thin or let the sky through.
_THIN: Final = ("wire", "pole", "lamp", "sign", "fence", "crane", "bollard", "hydrant")
# Height over which the edge of a shadow fades: now, and at past hours, each of which stands for an
# hour of the sun's motion.
_FADE_M, _HOURLY_FADE_M = 0.5, 2.5
# Height of the solid part of objects, as a share of the height of their box. Masts give no shade.
_SOLID: Final[dict[str, float]] = {"boat": 0.3}
# Shade must exceed a point by this height, so that a point is not shaded by its own cell.
_CLEAR_M: Final = 0.15


class Shade:
    """The shade of a place under the sun at several times.

    Args:
        world: The place.
        suns: Unit vectors (K, 3) towards the sun, east-north-up.
    """

    def __init__(self, world: World, suns: Array) -> None:
        self._n = int(np.clip(world.side_m / _MIN_CELL_M, 2, _MAX_CELLS))
        self._cell_m = world.side_m / self._n
        height = _raise_objects(world, _terrain(world, self._n, self._cell_m), self._cell_m)
        self._maps = [_cast(height, self._cell_m, sun) if sun[2] > 0 else None for sun in suns]

    def __call__(self, k: int, points: Float, normals: Float) -> Float:
        """Return the share (H, W) of the direct sun that is hidden at time ``k``, 0 to 1.

        Args:
            k: Number of the time; 0 is the present.
            points: World points (H, W, 3), metres.
            normals: Unit normals (H, W, 3) of the surfaces at the points.
        """
        top = self._maps[k]
        if top is None:
            return np.ones(points.shape[:2], np.float32)
        # Points are moved away from the surface, so that a wall is not in its own shade.
        at = (points[..., :2] + self._cell_m * normals[..., :2]) / self._cell_m
        column, row = np.moveaxis(at + (0.5 * self._n - 0.5), -1, 0).astype(np.float32)
        reach = cv2.remap(
            top, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
            borderValue=_OUTSIDE_M,
        )  # fmt: skip
        fade = _FADE_M if k == 0 else _HOURLY_FADE_M
        return np.asarray(np.clip((reach - points[..., 2] - _CLEAR_M) / fade, 0, 1))


def _terrain(world: World, n: int, cell_m: float) -> Float:
    """Return the height (n, n) of the terrain, metres; row 0 is south."""
    axis = (np.arange(n) + 0.5 - 0.5 * n) * cell_m
    rows = [world.terrain.height(axis, np.full(n, y)) for y in axis]
    return np.asarray(rows, np.float32)


def _raise_objects(world: World, height: Float, cell_m: float) -> Float:
    """Raise a height map (n, n) to the tops of objects, in place, and return it."""
    n = len(height)
    for item in world.objects:
        if item.class_name in _THIN or item.shape.startswith("bare_"):
            continue
        reach = 0.5 * float(np.hypot(item.size[0], item.size[1]))
        low, high = (
            np.clip(np.floor((item.centre[:2] + way * reach) / cell_m + 0.5 * n), 0, n).astype(int)
            for way in (-1, 1)
        )
        columns, rows = np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)
        columns, rows = columns[columns < n], rows[rows < n]
        if not (len(columns) and len(rows)):
            continue
        x = (columns + 0.5 - 0.5 * n) * cell_m - item.centre[0]
        y = (rows + 0.5 - 0.5 * n) * cell_m - item.centre[1]
        cos, sin = np.cos(item.yaw), np.sin(item.yaw)
        along = cos * x[None, :] + sin * y[:, None]
        across = -sin * x[None, :] + cos * y[:, None]
        part = height[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        np.maximum(part, _top(item, along, across), out=part)
    return height


def _top(item: WorldObject, along: Array, across: Array) -> Float:
    """Return the height of an object's top at positions (h, w) in its box, metres.

    Outside of the object it is ``_OUTSIDE_M``.
    """
    half = np.maximum(0.5 * item.size, 1e-6)
    s, t = along / half[0], across / half[1]
    inside = (np.abs(s) <= 1) & (np.abs(t) <= 1)
    solid = _SOLID.get(item.class_name, 1.0) * item.size[2]
    top = np.full(s.shape, item.centre[2] - half[2] + solid)
    style = item.style
    if style is not None:
        if style.wing_width_share < 1:
            in_front = t < 1 - 2 * style.main_depth_share
            inside &= ~(in_front & (s > 2 * style.wing_width_share - 1))
        if style.roof != "flat":
            top -= style.roof_height_m * np.minimum(np.abs(t), 1)
    elif item.class_name == "tree":
        r2 = s**2 + t**2
        inside = r2 <= 1
        is_cone = item.shape.startswith("conifer")
        drop = np.sqrt(r2) if is_cone else 1 - np.sqrt(np.maximum(1 - r2, 0))
        top -= (1.8 if is_cone else 1.2) * half[2] * drop
    return np.asarray(np.where(inside, top, _OUTSIDE_M), np.float32)


def _cast(height: Float, cell_m: float, sun: Array) -> Float:
    """Return the height (n, n) up to which the shade reaches, metres, under a sun (3,).

    The distance towards the sun doubles from step to step.
    """
    level = float(np.hypot(sun[0], sun[1]))
    if level < 1e-6:
        return np.full_like(height, _OUTSIDE_M)
    towards, rise = sun[:2] / level, float(sun[2]) / level
    span = float(height.max() - height.min())
    # The first step leaves the cell itself out.
    reach = _step(height, towards, 1.0) - rise * cell_m
    steps = 1.0
    while rise * steps * cell_m < span and steps < len(height):
        reach = np.maximum(reach, _step(reach, towards, steps) - rise * steps * cell_m)
        steps *= 2
    return reach


def _step(height: Float, towards: Array, cells: float) -> Float:
    """Return the heights (n, n) at positions moved by ``cells`` in a unit direction (2,)."""
    move = np.array([[1.0, 0.0, cells * towards[0]], [0.0, 1.0, cells * towards[1]]])
    moved = cv2.warpAffine(
        height, move, height.shape[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT, borderValue=_OUTSIDE_M,
    )  # fmt: skip
    return np.asarray(moved, np.float32)
