"""Plans of procedural places: streets, uses of the blocks between them, and objects along them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np

from objconnect.scene.errors import InputError
from simulate.place.builder import PlaceBuilder
from simulate.place.kerbs import lay_kerbs, raise_objects
from simulate.place.paint import paint
from simulate.place.relief import Point, relief
from simulate.place.streets import (
    TOWN_STREETS,
    Block,
    Lattice,
    StreetKind,
    divide,
    draw_bounded_lattice,
    draw_lattice,
    lay_streets,
    outlines,
)
from simulate.place.world import Heightfield, Surroundings, World

MIN_SIDE_M, MAX_SIDE_M = 100.0, 2000.0
TILE_TEXEL_M: Final = 0.25
"""Side of a ground texel in a tiled place, metres: about that of a place of 1 km."""
_CORE_M = 600.0  # farther from the middle, most blocks are open land
_OUTSKIRTS_OPEN = 0.92  # share of open land among those blocks

Use = Callable[[PlaceBuilder, Block], None]
"""A function that fills a block."""
RoadsidePlacer = Callable[[PlaceBuilder], None]
"""A function that places objects along the roads."""


class Relief(Protocol):
    """A function that draws terrain; see ``simulate.place.relief.relief``."""

    def __call__(
        self, side_m: float, rng: np.random.Generator, centre: Point = ...
    ) -> Heightfield: ...


@dataclass(frozen=True)
class Quarter:
    """The use of the blocks of a place, or of one part of it.

    The blocks nearest the centre get the uses in ``first``, one each, so that small places have
    these uses too. Of the other blocks, a share ``open_share`` is open land; beyond 600 m from the
    centre, the share is at least 92 %. The uses of the rest are drawn from ``uses`` by weight.
    ``name`` is the name of the part of a place with several parts.
    """

    first: tuple[Use, ...]
    uses: Mapping[Use, float]
    open_land: Use
    open_share: float
    name: str = ""

    def fill(self, builder: PlaceBuilder, blocks: Sequence[Block]) -> None:
        """Choose the use of each block and fill it. Blocks are sorted by distance to the centre."""
        first = [self.first[i] for i in builder.rng.permutation(len(self.first))]
        uses, weights = tuple(self.uses), tuple(self.uses.values())
        for i, block in enumerate(blocks):
            in_core = float(np.linalg.norm(block.centre())) < _CORE_M
            if i < len(first):
                first[i](builder, block)
            elif builder.chance(
                self.open_share if in_core else max(self.open_share, _OUTSKIRTS_OPEN)
            ):
                self.open_land(builder, block)
            else:
                uses[int(builder.rng.choice(len(uses), p=weights))](builder, block)


@dataclass(frozen=True)
class Plan:
    """The recipe of a kind of place.

    The place is divided among the quarters, one column of blocks after the other, so that the
    streets along its first axis lead from each quarter to the next.

    Attributes:
        block_m: Typical distance between streets, metres.
        quarters: The parts of the place.
        after_blocks: Functions that place objects along the roads after the blocks are filled.
        before_blocks: Functions that place objects along the roads before the blocks are filled.
        streets: The appearance of the streets.
        min_side_m: Minimum side of the place, metres, at which every quarter has room.
        relief: The function that draws the terrain.
        steep: Whether the ground is so steep that vehicles lean with it.
    """

    block_m: float
    quarters: tuple[Quarter, ...]
    after_blocks: tuple[RoadsidePlacer, ...]
    before_blocks: tuple[RoadsidePlacer, ...] = ()
    streets: StreetKind = TOWN_STREETS
    min_side_m: float = MIN_SIDE_M
    relief: Relief = relief
    steep: bool = False

    def build(self, seed: int, side_m: float) -> World:
        """Build a square place of side ``side_m`` (metres); equal arguments give equal places.

        Raises:
            InputError: ``side_m`` is not within ``min_side_m`` and 2000 m, the seed is negative, or
                the place needs more objects than there are ids.
        """
        if not self.min_side_m <= side_m <= MAX_SIDE_M:
            raise InputError(
                f"area must be {self.min_side_m:.0f} to {MAX_SIDE_M:.0f} m a side, got {side_m:g}"
            )
        if seed < 0:
            raise InputError(f"seed must not be negative, got {seed}")
        rng = np.random.default_rng([seed, 0])
        builder = PlaceBuilder(side_m, self.relief(side_m, rng), rng, self.steep)
        pitch_m = self._pitch_m(side_m)
        return self._build(builder, draw_lattice(rng, side_m, pitch_m, self.streets), seed)

    def build_tile(self, seed: int, side_m: float, index: tuple[int, int], centre: Point) -> World:
        """Build one tile of a tiled place, see ``simulate.place.tiles``.

        The tile is bounded by roads, and its coordinates are relative to its centre. Its heights
        equal those of the neighbouring tiles on the common border.

        Args:
            seed: Seed of the tiled place.
            side_m: Side of the tile, metres.
            index: Row, from the south, and column, from the west, of the tile.
            centre: Centre of the tile in the tiled place, metres.

        Raises:
            InputError: The tile needs more objects than there are ids.
        """
        terrain = self.draw_relief(seed, side_m, centre)
        key = [seed, 0, *index]
        rng = np.random.default_rng(key)
        builder = PlaceBuilder(side_m, terrain, rng, self.steep)
        pitch_m = self._pitch_m(side_m)
        lattice = draw_bounded_lattice(rng, side_m, pitch_m, self.streets)
        tile_seed = int(np.random.SeedSequence(key).generate_state(1)[0])
        world = self._build(builder, lattice, tile_seed, TILE_TEXEL_M)
        # Still water levels the ground around it, which must not reach the neighbouring tiles.
        nodes = world.terrain.nodes.copy()
        nodes[[0, -1]], nodes[:, [0, -1]] = terrain.nodes[[0, -1]], terrain.nodes[:, [0, -1]]
        return replace(world, terrain=Heightfield(nodes, terrain.spacing_m))

    def draw_relief(self, seed: int, side_m: float, centre: Point = (0.0, 0.0)) -> Heightfield:
        """Return the terrain of a square in a tiled place, before still water levels it."""
        return self.relief(side_m, np.random.default_rng([seed, 0]), centre)

    def _pitch_m(self, side_m: float) -> float:
        return side_m / max(2, len(self.quarters), round(side_m / self.block_m))

    def _build(
        self, builder: PlaceBuilder, lattice: Lattice, seed: int, texel_m: float | None = None
    ) -> World:
        """Build a place on its terrain, with streets on a lattice; ``seed`` draws its textures."""
        side_m = builder.side_m
        blocks = lay_streets(builder, lattice, self._pitch_m(side_m), self.streets)
        carriageways = [r for r in builder.regions if r.class_name == self.streets.surface]
        for place_roadside in self.before_blocks:
            place_roadside(builder)
        parts = divide(blocks, side_m, len(self.quarters))
        for quarter, part in zip(self.quarters, parts, strict=True):
            quarter.fill(builder, part)
        for place_roadside in self.after_blocks:
            place_roadside(builder)
        if lattice.bounded:
            # Blocks with straight sides may reach over streets, which bend more in a tile.
            builder.regions += carriageways
        ground = paint(side_m, builder.regions, builder.markings, texel_m)
        kerbs = lay_kerbs(builder.roads, ground)
        return World(
            seed=seed,
            side_m=float(side_m),
            terrain=builder.terrain,
            roads=builder.roads,
            ground=ground,
            objects=raise_objects(builder.objects, kerbs),
            kerbs=kerbs,
            surroundings=tuple(
                Surroundings(quarter.name, outline)
                for quarter, outline in zip(self.quarters, outlines(parts, side_m), strict=True)
                if quarter.name
            ),
        )
