"""Plans of procedural places: streets, uses of the blocks between them, and objects along them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from objconnect.scene.errors import InputError
from simulate.place.builder import PlaceBuilder
from simulate.place.kerbs import lay_kerbs, raise_objects
from simulate.place.paint import paint
from simulate.place.relief import relief
from simulate.place.streets import (
    TOWN_STREETS,
    Block,
    StreetKind,
    divide,
    lay_streets,
    outlines,
)
from simulate.place.world import Heightfield, Surroundings, World

MIN_SIDE_M, MAX_SIDE_M = 100.0, 2000.0
_CORE_M = 600.0  # farther from the middle, most blocks are open land
_OUTSKIRTS_OPEN = 0.92  # share of open land among those blocks

Use = Callable[[PlaceBuilder, Block], None]
"""A function that fills a block."""
RoadsidePlacer = Callable[[PlaceBuilder], None]
"""A function that places objects along the roads."""
Relief = Callable[[float, np.random.Generator], Heightfield]
"""A function that draws the terrain of a place from its side in metres."""


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
        least = max(2, len(self.quarters))
        pitch_m = side_m / max(least, round(side_m / self.block_m))
        blocks = lay_streets(builder, pitch_m, self.streets)
        for line_roads in self.before_blocks:
            line_roads(builder)
        parts = divide(blocks, side_m, len(self.quarters))
        for quarter, part in zip(self.quarters, parts, strict=True):
            quarter.fill(builder, part)
        for line_roads in self.after_blocks:
            line_roads(builder)
        ground = paint(side_m, builder.regions, builder.markings)
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
