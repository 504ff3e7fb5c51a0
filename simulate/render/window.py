"""Windows of tiled places: the tiles that a frame needs, and the world that they make.

A frame needs the tiles that it shows, and those whose objects may shade or light what it shows.
Frames with the same window are rendered by the same processes, whose memory depends on the window
and not on the place.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from objconnect.scene.errors import InputError
from simulate.camera.pinhole import PinholeCamera
from simulate.place.change import Change, change_world
from simulate.place.tiles import Index, TiledPlace, renumber
from simulate.place.world import World
from simulate.render.reach import REACH_M

Array = NDArray[np.float64]

MAX_VIEW_M: Final = 800.0
"""Horizontal distance from the camera up to which a window holds the tiles of a view, metres."""
_SIZES: Final = (3, 5)  # numbers of tiles a side that a window may have
_TALL_M: Final = 60.0  # upper bound of the height of objects above the highest ground
_OVERHANG_M: Final = 30.0  # upper bound of the distance that an object extends beyond its tile
_STEEP: Final = math.tan(math.radians(30))  # minimum descent of a steep ray per horizontal metre
_EDGE_RAYS: Final = 9  # number of rays along each side of a picture
MAX_SCENE_ID: Final = (1 << 16) - 1
"""Largest id of an object in the frames of a scene; ids in tiles that no frame shows are larger."""


class TileIds(BaseModel):
    """The ids of the objects of a tile in a scene.

    Attributes:
        offset: Id in the scene minus id in the tile.
        first_new_id: First id in the tile of objects that the session's change moves or adds.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    offset: int
    first_new_id: int


class Window(BaseModel):
    """A square of tiles, and the frames that are rendered in it.

    Attributes:
        first: Row and column of the tile in the south-west.
        side: Number of tiles a side.
        ids: Ids of the tiles, row by row; None for a tile that no frame of the scene shows.
        frames: Numbers of the frames.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    first: Index
    side: int
    ids: tuple[TileIds | None, ...]
    frames: tuple[int, ...]

    def tiles(self) -> list[Index]:
        """Return the indices of the tiles, row by row from the south-west."""
        return square_of_tiles(self.first, self.side)


class View(NamedTuple):
    """The tiles that a frame needs.

    Attributes:
        first: Row and column of the tile in the south-west of its window.
        side: Number of tiles a side of its window.
        shown: Indices of the tiles whose objects the frame may show.
    """

    first: Index
    side: int
    shown: frozenset[Index]


def square_of_tiles(first: Index, side: int) -> list[Index]:
    """Return the indices of a square of tiles, row by row from the south-west."""
    return [(first[0] + row, first[1] + column) for row in range(side) for column in range(side)]


def find_view(
    place: TiledPlace, camera: PinholeCamera, cam_from_world: Array, heights: tuple[float, float]
) -> View:
    """Return the tiles that a frame needs.

    The window holds what the frame may show up to ``MAX_VIEW_M`` from the camera, and if possible
    what may shade or light it.

    Args:
        place: The tiled place.
        camera: The pinhole camera.
        cam_from_world: Pose (4, 4).
        heights: The lowest and the highest ground of the place, metres.

    Raises:
        InputError: The frame shows more than a window of five tiles a side.
    """
    low, high = _visible_box(camera, cam_from_world, heights, MAX_VIEW_M)
    first, last = place.index(low - REACH_M), place.index(high + REACH_M)
    middle = place.index(0.5 * (low + high))
    for side in _SIZES:
        start = np.clip(middle - side // 2, 0, max(place.count - side, 0))
        if (first >= start).all() and (last < start + side).all():
            break
    if (place.index(low) < start).any() or (place.index(high) >= start + side).any():
        raise InputError(
            f"it shows ground of {high[0] - low[0]:.0f} x {high[1] - low[1]:.0f} m, more than "
            f"{side} x {side} tiles: fly lower or look down more steeply"
        )
    side = min(side, place.count)
    window = (int(start[0]), int(start[1]))
    # Objects of the window are shown beyond ``MAX_VIEW_M`` too.
    low, high = _visible_box(camera, cam_from_world, heights, 2 * side * place.tile_m)
    shown = {
        (row, column)
        for row in _range(place, low, high, 0)
        for column in _range(place, low, high, 1)
    }
    return View(window, side, frozenset(shown & set(square_of_tiles(window, side))))


def _range(place: TiledPlace, low: Array, high: Array, axis: int) -> range:
    """Return the rows (axis 0) or columns (axis 1) of the tiles that a view may show."""
    first = place.index(low - _OVERHANG_M)[axis]
    return range(int(first), int(place.index(high + _OVERHANG_M)[axis]) + 1)


def _visible_box(
    camera: PinholeCamera,
    cam_from_world: Array,
    heights: tuple[float, float],
    max_distance_m: float,
) -> tuple[Array, Array]:
    """Return the south-west and north-east corners (2,) of the area that a frame may show, metres.

    Points farther than ``max_distance_m`` from the camera count only on rays that point more than
    30 degrees below the horizon.
    """
    edge = np.linspace(0, 1, _EDGE_RAYS)
    zeros, ones = np.zeros_like(edge), np.ones_like(edge)
    border = np.concatenate(
        [np.stack(pair, -1) for pair in ((edge, zeros), (edge, ones), (zeros, edge), (ones, edge))]
    )
    pixels = border * [camera.width, camera.height]
    local = np.column_stack([(pixels - [camera.cx, camera.cy]) / camera.f, np.ones(len(pixels))])
    rays = local @ cam_from_world[:3, :3]
    centre = -cam_from_world[:3, :3].T @ cam_from_world[:3, 3]
    across = np.linalg.norm(rays[:, :2], axis=1)
    is_steep = -rays[:, 2] > _STEEP * across
    capped = max_distance_m / np.maximum(across, 1e-9)
    farthest = np.where(is_steep, np.inf, capped)
    points = []
    for z in (heights[0], heights[1] + _TALL_M):
        with np.errstate(divide="ignore", invalid="ignore"):
            length = (z - centre[2]) / rays[:, 2]
        # Rays that do not intersect the lower plane end at the maximum distance. Rays that do not
        # intersect the upper plane start at the camera.
        otherwise = capped if z == heights[0] else np.zeros_like(capped)
        length = np.where(length > 0, np.minimum(length, farthest), otherwise)
        points.append(centre[:2] + length[:, None] * rays[:, :2])
    ends = np.concatenate(points)
    return ends.min(0), ends.max(0)


def group_views(views: Mapping[int, View], ids: Mapping[Index, TileIds]) -> tuple[Window, ...]:
    """Return the windows of frames, in the order of their rows and columns.

    Args:
        views: The view of each frame, by its number.
        ids: The ids of all tiles that a frame of the scene shows.
    """
    frames: dict[tuple[Index, int], list[int]] = {}
    for frame, view in views.items():
        frames.setdefault((view.first, view.side), []).append(frame)
    return tuple(
        Window(
            first=first,
            side=side,
            ids=tuple(ids.get(index) for index in square_of_tiles(first, side)),
            frames=tuple(sorted(numbers)),
        )
        for (first, side), numbers in sorted(frames.items())
    )


def build_window(place: TiledPlace, window: Window, change: Change) -> World:
    """Return the world of a window after a change; its origin is the window's centre.

    Objects have the ids of the scene. In tiles that no frame shows, ids are above ``MAX_SCENE_ID``.
    """
    tiles = []
    hidden_offset = MAX_SCENE_ID
    for index, ids in zip(window.tiles(), window.ids, strict=True):
        tile = place.tile(index)
        changed = change_world(tile, change, 0 if ids is None else ids.first_new_id).world
        tiles.append(renumber(changed, hidden_offset if ids is None else ids.offset))
        if ids is None:
            hidden_offset = max((item.id for item in tiles[-1].objects), default=hidden_offset)
    rows = [tiles[k : k + window.side] for k in range(0, len(tiles), window.side)]
    return place.assemble(rows)


def move_pose(cam_from_world: Array, centre: tuple[float, float]) -> Array:
    """Return a pose (4, 4) in the coordinates of a window with a centre (2,) in the place."""
    pose = cam_from_world.copy()
    pose[:3, 3] += pose[:3, :3] @ [*centre, 0.0]
    return pose
