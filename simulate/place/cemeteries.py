"""Build blocks of a cemetery: rows of graves, and a chapel.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulate.place.builder import PAVEMENT_M, Footing, ObjectSpec, PlaceBuilder
from simulate.place.objects import barrier, bench, car, small_object, tree
from simulate.place.streets import Block
from simulate.place.styles import chapel_style, vary
from simulate.place.world import Rgb

# Linear albedo of stones: light and dark granite, red granite, marble, sandstone.
_STONES: tuple[Rgb, ...] = (
    (0.30, 0.30, 0.29),
    (0.055, 0.056, 0.06),
    (0.20, 0.10, 0.085),
    (0.58, 0.57, 0.54),
    (0.34, 0.26, 0.17),
)
_GRAVES = ("planted_grave", "slab_grave", "cross_grave")


@dataclass(frozen=True)
class Graves:
    """The graves of a place.

    Attributes:
        size: Length, width and height of a grave, metres.
        row_spacing_m: Distance between rows.
        grave_spacing_m: Distance between graves of a row.
        stones: Colours of the stones.
        weights: Shares of the kinds of graves.
        occupied_share: Share of the positions with a grave.
    """

    size: tuple[float, float, float]
    row_spacing_m: float
    grave_spacing_m: float
    stones: tuple[Rgb, ...]
    weights: tuple[float, ...]
    occupied_share: float


def draw_graves(builder: PlaceBuilder) -> Graves:
    """Draw the sizes, distances and stones of the graves."""
    rng = builder.rng
    width = rng.uniform(1.0, 1.5)
    stones = rng.permutation(len(_STONES))[: int(rng.integers(1, 4))]
    weights = rng.dirichlet((0.8,) * len(_GRAVES))
    return Graves(
        size=(rng.uniform(2.1, 2.5), width, rng.uniform(0.9, 1.3)),
        row_spacing_m=rng.uniform(3.4, 4.2),
        grave_spacing_m=width + rng.uniform(0.7, 1.4),
        stones=tuple(_STONES[k] for k in stones),
        weights=tuple(weights.tolist()),
        occupied_share=rng.uniform(0.8, 0.95),
    )


def graves(builder: PlaceBuilder, block: Block) -> None:
    """Lay rows of graves on both sides of a path, inside a hedge."""
    kind = builder.once(draw_graves)
    rng, frame = builder.rng, block.front(1)
    length, depth = block.length, block.depth
    builder.paint("grass", frame.quad(0, length, 0, depth), float(rng.random()))
    middle = 0.5 * length
    path = frame.quad(middle - 1.1, middle + 1.1, -PAVEMENT_M - 0.5, depth + PAVEMENT_M + 0.5)
    builder.paint("path", path, 0.6)
    builder.reserve(path)
    for b in (4.0, depth - 4.0):
        bench(builder, frame.point(middle + 2.0, b), frame.yaw(middle, b) + np.pi / 2)
        small_object(builder, "bin", frame.point(middle - 1.7, b), 0.0)
    for b in np.arange(4.5, depth - 3.0, kind.row_spacing_m):
        foot = b - 0.5 * kind.size[0] - 0.6
        builder.paint("path", frame.quad(2.5, length - 2.5, foot - 0.4, foot + 0.4), 0.6)
        for a in np.arange(3.0, length - 3.0, kind.grave_spacing_m):
            if builder.chance(kind.occupied_share):
                shape = _GRAVES[int(rng.choice(len(_GRAVES), p=kind.weights))]
                stone = vary(builder, builder.choose(kind.stones))
                grave = ObjectSpec("grave", shape, kind.size, stone)
                yaw = frame.yaw(a, b) - np.pi / 2 + rng.normal(0, 0.01)
                builder.place(grave, frame.point(a, b), yaw, Footing(gap_m=0.1))
            elif builder.chance(0.3):
                tree(builder, frame.point(a, b), rng.uniform(0.5, 1.0), conifers=0.8)
    for a0, a1 in ((0.5, middle - 2.0), (middle + 2.0, length - 0.5)):
        for b in (0.4, depth - 0.4):
            barrier(builder, "hedge", frame, (a0, b), (a1, b), (0.7, 1.1))


def chapel(builder: PlaceBuilder, block: Block) -> None:
    """Place a chapel with a tower on a forecourt, with parked cars and old trees around it."""
    rng, frame = builder.rng, block.front(int(builder.rng.choice([1, -1])))
    length, depth = block.length, block.depth
    builder.paint("grass", frame.quad(0, length, 0, depth), float(rng.random()))
    middle, b = 0.5 * length, 0.5 * depth
    builder.paint("pavement", frame.quad(middle - 9, middle + 9, b - 9, b + 9), 0.5)
    builder.paint("pavement", frame.quad(middle - 4, middle + 4, -PAVEMENT_M - 0.5, b), 0.5)
    builder.reserve(frame.quad(middle - 4, middle + 4, -PAVEMENT_M - 0.5, b - 8))
    style = chapel_style(builder, tower=False)
    nave = (rng.uniform(13, 18), rng.uniform(7.5, 9.5))
    size = (*nave, 5.5 + style.roof_height_m)
    yaw = frame.yaw(middle, b)
    builder.place(ObjectSpec("building", "chapel", size, style=style), frame.point(middle, b), yaw)
    style = chapel_style(builder, tower=True)
    tower = ObjectSpec("building", "chapel", (4.6, 4.6, 11.0 + style.roof_height_m), style=style)
    a = middle - 0.5 * nave[0] - 2.35
    builder.place(tower, frame.point(a, b), yaw, Footing(gap_m=0.0))
    for k in range(4):
        if builder.chance(0.6):
            car(builder, frame.point(middle + 6.5 + 2.6 * k, 3.0), yaw + np.pi / 2)
    for _ in range(int(0.012 * length * depth)):
        a, b = rng.uniform(2, length - 2), rng.uniform(3, depth - 2)
        tree(builder, frame.point(a, b), rng.uniform(2.0, 4.5), conifers=0.4)
