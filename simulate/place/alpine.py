"""Build blocks of an alpine village: chalets on sloping meadows, and pastures with barns.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

import numpy as np

from simulate.place.builder import PAVEMENT_M, ObjectSpec, PlaceBuilder
from simulate.place.farms import pasture
from simulate.place.objects import barrier, building, car, small_object, tree
from simulate.place.streets import Block, StreetFrame
from simulate.place.styles import chalet_style


def chalets(builder: PlaceBuilder, block: Block) -> None:
    """Place chalets along both streets on one meadow, with trees, mostly conifers, between them."""
    rng = builder.rng
    length, depth = block.length, block.depth
    frame = block.front(1)
    builder.paint("grass", frame.quad(0, length, 0, depth), float(rng.random()))
    for side in (1, -1):
        a = rng.uniform(0.0, 6.0)
        while a + 16.0 < length:
            width = rng.uniform(16.5, 22.0)
            _chalet(builder, block.front(side).shift(a + 0.5 * width), 0.5 * depth)
            a += width
    for _ in range(int(0.008 * length * depth)):
        a, b = rng.uniform(1, length - 1), rng.uniform(2, depth - 2)
        tree(builder, frame.point(a, b), rng.uniform(1.2, 3.2), conifers=0.75)


def _chalet(builder: PlaceBuilder, frame: StreetFrame, depth: float) -> None:
    """Place a chalet ahead of the frame's origin, with a drive.

    Wood piles, a car and a fence may stand beside it.
    """
    rng = builder.rng
    size = rng.uniform(10.5, 14.5), rng.uniform(10.0, 12.5)
    style = chalet_style(builder, size[1])
    height = 2.7 * style.floors + 0.6 + style.roof_height_m
    b = rng.uniform(4.0, max(4.5, depth - size[0] - 3.0)) + 0.5 * max(size)
    drive = frame.quad(-0.5 * size[0] - 3.6, -0.5 * size[0] - 0.6, -PAVEMENT_M - 0.8, b)
    builder.paint("path", drive, float(rng.random()))
    builder.paint("path", frame.quad(-0.5 * size[0] - 1.0, 0.0, b - 7.5, b), float(rng.random()))
    yaw = frame.yaw(0, b) + builder.choose((0.0, np.pi / 2)) + rng.normal(0, 0.06)
    spec = ObjectSpec("building", "house", (*size, height), style=style)
    if not builder.place(spec, frame.point(0, b), yaw):
        return
    if builder.chance(0.7):
        position = frame.point(-0.5 * size[0] - 2.1, rng.uniform(2.8, b))
        car(builder, position, frame.yaw(0, b) + np.pi / 2)
    for a in (0.5 * max(size) + 1.2, 0.5 * max(size) + 2.6):
        if builder.chance(0.5):
            small_object(builder, "pallet", frame.point(a, b), frame.yaw(a, b))
    if builder.chance(0.3):
        barrier(builder, "fence", frame, (-3.0, 1.0), (9.0, 1.0), (0.1, 1.0))


def alpine_pasture(builder: PlaceBuilder, block: Block) -> None:
    """Lay a pasture with a few hay barns and some bales."""
    rng = builder.rng
    pasture(builder, block)
    frame, length, depth = block.front(1), block.length, block.depth
    for _ in range(int(rng.integers(1, 4))):
        a, b = rng.uniform(6, length - 6), rng.uniform(6, depth - 6)
        style = chalet_style(builder, 6.0)
        building(builder, "shed", frame, (a, b), (8.0, 6.0, 3.4 + style.roof_height_m), style)
        small_object(builder, "bale", frame.point(a + 6.5, b), rng.uniform(-np.pi, np.pi))
