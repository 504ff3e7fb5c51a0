"""Tiled places: places of several kilometres. Only the tiles near a camera are built.

The borders of a tile are roads. A tile lays only its own half of each border road, so that
neighbouring tiles fit together although each is built alone. Terrain is continuous across the
borders. Each object lies in a single tile. Equal plans, seeds and sides give equal tiles, in any
order and in any process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from objconnect.scene.bundle.labels import CLASSES
from objconnect.scene.errors import InputError
from simulate.place.plan import MAX_SIDE_M, Plan
from simulate.place.world import (
    MAX_OBJECT_ID,
    Ground,
    Heightfield,
    Kerb,
    Marking,
    Road,
    World,
    WorldObject,
)

Array = NDArray[np.float64]
Index = tuple[int, int]

MAX_TILED_SIDE_M: Final = 20_000.0
_TILE_M: Final = 1000.0 / 3  # approximate side of a tile
_CACHED_TILES: Final = 32  # a tile takes about 5 MB
_CACHED_TERRAINS: Final = 1024  # 0.2 MB each
_ROADS_M: Final = 1000.0  # distance from the middle up to which flights may follow roads
_KEY_LIMIT: Final = 1 << 24  # object keys (seeds) are below it, so that float32 is exact
_ROAD_STEP_M: Final = 3.0  # distance between the points of a road


def is_tiled(side_m: float) -> bool:
    """Return whether a procedural place of a side in metres is tiled."""
    return side_m > MAX_SIDE_M


class TiledPlace:
    """A square place of ``side_m`` metres, which consists of equal tiles of about 333 m.

    Args:
        plan: Plan of the tiles, with a single quarter (part of the place).
        seed: Seed of the place.
        side_m: Side of the place, metres.

    Raises:
        InputError: The side is too large, or the plan has several quarters.
    """

    def __init__(self, plan: Plan, seed: int, side_m: float) -> None:
        if not side_m <= MAX_TILED_SIDE_M:
            raise InputError(f"area must be at most {MAX_TILED_SIDE_M:.0f} m, got {side_m:g}")
        if len(plan.quarters) > 1:
            raise InputError(
                f"a place of several quarters cannot be tiled: choose an area of at most "
                f"{MAX_SIDE_M:.0f} m, got {side_m:g}"
            )
        self.count = round(side_m / _TILE_M)
        self.tile_m = side_m / self.count
        self.seed, self.side_m = seed, side_m
        self._plan = plan
        self._relief = plan.draw_relief(seed, side_m)
        self._terrain: Callable[[Index], Heightfield] = lru_cache(_CACHED_TERRAINS)(
            lambda index: self.tile(index).terrain
        )
        self.tile: Callable[[Index], World] = lru_cache(_CACHED_TILES)(self._build)
        """Returns the tile of a row (from the south) and column, in its own coordinates."""

    def centre(self, index: Index) -> Array:
        """Return the centre (2,) of a tile, metres."""
        row, column = index
        return self.tile_m * (np.array([column, row]) - 0.5 * (self.count - 1))

    def index(self, points: ArrayLike) -> NDArray[np.int64]:
        """Return the row and column (..., 2) of the tile under each point (..., 2), metres.

        Points outside the place belong to the nearest tile.
        """
        cells = np.floor(np.asarray(points, float) / self.tile_m + 0.5 * self.count)
        return np.asarray(np.clip(cells.astype(np.int64), 0, self.count - 1)[..., ::-1])

    def land(self) -> World:
        """Return the place without objects, whose ground is one texel of grass.

        Its roads are the borders of tiles within ``_ROADS_M`` of the middle. The method ``height``
        of its terrain builds the tiles under the points and returns exact heights; the nodes of its
        terrain are coarse.
        """
        half = min(0.5 * self.side_m, _ROADS_M)
        along = np.linspace(-half, half, round(2 * half / _ROAD_STEP_M) + 1)
        lines = self.tile_m * (np.arange(1, self.count) - 0.5 * self.count)
        lines = lines[np.abs(lines) < half]
        width = self._plan.streets.widths_m[0]
        roads = [
            Road(np.stack([along, np.full_like(along, at)], -1)[:, order], width, main=False)
            for order in ([0, 1], [1, 0])
            for at in lines
        ]
        grass = np.full((1, 1), CLASSES["grass"], np.uint8)
        ground = Ground(self.side_m, grass, np.full((1, 1), 128, np.uint8), ())
        terrain = _TiledHeights(self._relief.nodes, self._relief.spacing_m, self)
        return World(self.seed, self.side_m, terrain, tuple(roads), ground, ())

    def height(self, points: Array) -> Array:
        """Return the height (N,), metres, of the ground of the tiles at points (N, 2), metres."""
        heights = np.empty(len(points))
        for index, here in self.group_by_tile(points):
            heights[here] = self._terrain(index).height(*(points[here] - self.centre(index)).T)
        return heights

    def group_by_tile(self, points: Array) -> Iterator[tuple[Index, NDArray[np.int64]]]:
        """Yield each tile under some of the points (N, 2), metres, and the indices of these."""
        tiles = self.index(points)
        for row, column in np.unique(tiles, axis=0).tolist():
            yield (row, column), np.flatnonzero((tiles == [row, column]).all(1))

    def assemble(self, tiles: Sequence[Sequence[World]]) -> World:
        """Join neighbouring tiles to a square place, whose origin is its centre.

        Args:
            tiles: Rows of tiles from south to north. Their objects keep their ids.
        """
        count = len(tiles)
        side_m = count * self.tile_m
        objects: list[WorldObject] = []
        kerbs: list[Kerb] = []
        markings: list[Marking] = []
        for row, each in enumerate(tiles):
            for column, tile in enumerate(each):
                shift = self.tile_m * (np.array([column, row]) - 0.5 * (count - 1))
                objects += move(tile.objects, shift)
                kerbs += [Kerb(k.front + shift, k.back + shift, k.rise) for k in tile.kerbs]
                markings += [Marking(m.line + shift, m.width_m) for m in tile.ground.markings]
        spacing_m = tiles[0][0].terrain.spacing_m
        # Neighbours share the nodes on their border.
        strips = [np.hstack([*(t.terrain.nodes[:, :-1] for t in r[:-1]), r[-1].terrain.nodes])
                  for r in tiles]  # fmt: skip
        nodes = np.vstack([*(strip[:-1] for strip in strips[:-1]), strips[-1]])
        ground = Ground(
            tiles[0][0].ground.texel_m,
            np.block([[tile.ground.labels for tile in row] for row in tiles]),
            np.block([[tile.ground.tone for tile in row] for row in tiles]),
            tuple(markings),
        )
        return World(
            seed=self.seed,
            side_m=side_m,
            terrain=Heightfield(nodes, spacing_m),
            roads=(),
            ground=ground,
            objects=tuple(objects),
            kerbs=tuple(kerbs),
            tiles=tuple(map(tuple, tiles)),
        )

    def window_centre(self, first: Index, side: int) -> Array:
        """Return the centre (2,), metres, of a window of ``side`` x ``side`` tiles.

        ``first`` is the index of the tile in its south-west.
        """
        return self.centre(first) + 0.5 * (side - 1) * self.tile_m

    def _build(self, index: Index) -> World:
        x, y = self.centre(index).tolist()
        tile = self._plan.build_tile(self.seed, self.tile_m, index, (x, y))
        first_key = (1 + index[0] * self.count + index[1]) * (MAX_OBJECT_ID + 1)
        objects = tuple(replace(o, key=(first_key + o.id) % _KEY_LIMIT) for o in tile.objects)
        return replace(tile, objects=objects, land_heights=self._relief.nodes.ravel())


@dataclass(frozen=True)
class _TiledHeights(Heightfield):
    """Heights of a tiled place: ``height`` is exact, the coarse ``nodes`` give the range."""

    place: TiledPlace

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the ground height in metres at world x, y (metres, of equal shape)."""
        x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        return self.place.height(np.stack([x.ravel(), y.ravel()], -1)).reshape(x.shape)


def move(objects: Iterable[WorldObject], shift: Array) -> list[WorldObject]:
    """Return objects moved by a horizontal vector (2,), metres."""
    vector = np.array([*shift, 0.0])
    return [replace(item, centre=item.centre + vector) for item in objects]


def renumber(world: World, offset: int) -> World:
    """Return a world with ``offset`` added to the id of every object."""
    return replace(world, objects=tuple(replace(o, id=o.id + offset) for o in world.objects))
