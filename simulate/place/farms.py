"""Build blocks of farmland: farmyards, hayfields and pastures.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

import numpy as np

from simulate.place.builder import PAVEMENT_M, PlaceBuilder
from simulate.place.objects import barrier, building, car, place_fences, small_object, tree
from simulate.place.streets import Block, StreetFrame
from simulate.place.styles import hall_style, house_style


def farm(builder: PlaceBuilder, block: Block) -> None:
    """Place a farmhouse, a barn and a silo around a yard, and fields behind a hedge."""
    rng = builder.rng
    frame = block.front(int(rng.choice([1, -1])))
    length, depth = block.length, block.depth
    builder.paint("field", frame.quad(1, length - 1, 0.7 * depth, depth - 1), float(rng.random()))
    width = min(length, 70.0)
    yard = frame.shift(0.5 * (length - width))
    far = 8.0 + min(18.0, 0.3 * depth)  # where the yard ends
    builder.paint("path", yard.quad(0.12 * width, 0.88 * width, 8, far), float(rng.random()))
    drive = yard.quad(0.5 * width - 2, 0.5 * width + 2, -PAVEMENT_M - 1, 9)
    builder.paint("path", drive, float(rng.random()))
    builder.reserve(drive)

    style = house_style(builder, 12.0, 9.0)
    height = 2.8 * style.floors + 0.4 + style.roof_height_m
    building(builder, "house", yard, (0.24 * width, 8.0), (12.0, 9.0, height), style)
    style = hall_style(builder)
    barn = (min(26.0, 0.42 * width), 11.0, 5.5 + style.roof_height_m)
    building(builder, "hall", yard, (0.36 * width, far + 4.5), barn, style)
    small_object(builder, "tank", yard.point(0.78 * width, far + 1.5), rng.uniform(-np.pi, np.pi))
    for kind in ("tractor", "tractor", "bale", "bale", "bale", "pallet", "pallet"):
        for _ in range(4):
            a, b = rng.uniform(0.5, 0.86) * width, rng.uniform(11.0, far - 2.0)
            if small_object(builder, kind, yard.point(a, b), rng.uniform(-np.pi, np.pi)):
                break
    for _ in range(2):
        a = rng.uniform(0.58, 0.86) * width
        car(builder, yard.point(a, 9.5), yard.yaw(a, 9.5) + np.pi / 2)
    place_fences(builder, frame, length, depth, rng.uniform(1.0, 1.3))
    _hedge(builder, frame, length, 0.68 * depth)
    for _ in range(int(0.006 * length * depth) + 6):
        a, b = rng.uniform(1, length - 1), rng.uniform(2, 0.66 * depth)
        tree(builder, frame.point(a, b), rng.uniform(1.2, 3.8))


def hayfield(builder: PlaceBuilder, block: Block) -> None:
    """Lay a stubble field with rows of round bales and a hedge along one side."""
    rng = builder.rng
    frame = block.front(int(rng.choice([1, -1])))
    length, depth = block.length, block.depth
    builder.paint("field", frame.quad(1, length - 1, 1, depth - 1), float(rng.uniform(0.7, 1.0)))
    for b in np.arange(7.0, depth - 4.0, 12.0):
        for a in np.arange(6.0, length - 4.0, 10.0):
            if builder.chance(0.45):
                spot = frame.point(a + rng.normal(0, 1.0), b + rng.normal(0, 0.5))
                small_object(builder, "bale", spot, frame.yaw(a, b) + rng.normal(0, 0.3))
    if builder.chance(0.4):
        a, b = rng.uniform(4, length - 4), rng.uniform(4, depth - 4)
        small_object(builder, "tractor", frame.point(a, b), frame.yaw(a, b))
    _hedge(builder, frame, length, 0.5)


def pasture(builder: PlaceBuilder, block: Block) -> None:
    """Lay grass inside a fence, with a few trees."""
    rng = builder.rng
    frame = block.front(1)
    length, depth = block.length, block.depth
    builder.paint("grass", frame.quad(0, length, 0, depth), float(rng.random()))
    place_fences(builder, frame, length, depth, rng.uniform(1.0, 1.3))
    for _ in range(int(0.002 * length * depth) + 3):
        a, b = rng.uniform(3, length - 3), rng.uniform(3, depth - 3)
        tree(builder, frame.point(a, b), rng.uniform(2.0, 4.5))


def _hedge(builder: PlaceBuilder, frame: StreetFrame, length: float, b: float) -> None:
    """Place a hedge along the whole block at ``b``, in pieces that follow its bend."""
    height = builder.rng.uniform(1.4, 2.2)
    for a in np.arange(0.5, length - 12.0, 11.0):
        barrier(builder, "hedge", frame, (a, b), (a + 10.0, b), (1.2, height))
