"""Build blocks of open land: parks, fields, woods and meadows.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from simulate.place.builder import PlaceBuilder
from simulate.place.objects import barrier, bench, small_object, tree
from simulate.place.streets import Block
from simulate.place.world import polyline_length, polyline_points, ribbon


def park(builder: PlaceBuilder, block: Block) -> None:
    """Lay a park: grass, two winding paths with benches, trees, and a playing field if it fits."""
    rng = builder.rng
    frame = block.front(1)
    length, depth = block.length, block.depth
    builder.paint("grass", frame.quad(0, length, 0, depth), float(rng.random()))
    t = np.linspace(0, 1, 25)
    for (a0, b0), (a1, b1) in (
        ((0.15 * length, -1.5), (0.85 * length, depth + 1.5)),
        ((-1.5, rng.uniform(0.5, 0.9) * depth), (length + 1.5, rng.uniform(0.1, 0.5) * depth)),
    ):
        bend = rng.uniform(-5, 5) * np.sin(np.pi * t) + rng.uniform(-3, 3) * np.sin(2 * np.pi * t)
        path = frame.point(a0 + t * (a1 - a0) + bend, b0 + t * (b1 - b0) + bend)
        builder.paint("path", ribbon(path, 2.4), float(rng.random()))
        for p, q in pairwise(path):
            builder.reserve(ribbon(np.stack([p, q]), 2.6))
        for s in np.arange(rng.uniform(4, 9), polyline_length(path), 13.0):
            (p,), (along,) = polyline_points(path, s)
            side = builder.choose((1.0, -1.0))
            yaw = float(np.arctan2(along[1], along[0])) + (0 if side > 0 else np.pi)
            bench(builder, p + side * 1.9 * np.array([-along[1], along[0]]), yaw)
    for _ in range(12):  # try to place a playing field between the paths
        share = rng.uniform(0.7, 1.0)
        half = 13.0 * share, 8.0 * share
        a, b = rng.uniform(half[0], length - half[0]), rng.uniform(half[1], depth - half[1])
        playing_field = frame.quad(a - half[0], a + half[0], b - half[1], b + half[1])
        if builder.is_free(frame.point(a, b), (2 * half[0] + 3, 2 * half[1] + 3), frame.yaw(a, b)):
            builder.paint("grass", playing_field, 0.9)
            builder.reserve(playing_field)
            builder.mark(np.vstack([playing_field, playing_field[:1]]))
            builder.mark(frame.point([a, a], [b - half[1], b + half[1]]))
            break
    for _ in range(int(0.09 * length * depth)):
        a, b = rng.uniform(0, length), rng.uniform(0, depth)
        tree(builder, frame.point(a, b), rng.uniform(1.6, 5.0), conifers=0.25)


def field(builder: PlaceBuilder, block: Block) -> None:
    """Lay two fields of crops with a line of trees between them and hedges along one side."""
    rng = builder.rng
    frame = block.front(int(rng.choice([1, -1])))
    length, depth = block.length, block.depth
    split = rng.uniform(0.35, 0.65) * length
    builder.paint("field", frame.quad(1, split, 1, depth - 1), float(rng.random()))
    builder.paint("field", frame.quad(split, length - 1, 1, depth - 1), float(rng.random()))
    for a0 in np.arange(0.5, length - 12.0, 11.0):
        barrier(builder, "hedge", frame, (a0, 0.5), (a0 + 10.0, 0.5), (1.2, rng.uniform(1.4, 2.2)))
    for b in np.arange(4.0, depth - 3.0, 7.0):
        tree(builder, frame.point(split, b), rng.uniform(1.8, 3.4))


def woods(builder: PlaceBuilder, block: Block, conifers: tuple[float, float] = (0.1, 0.7)) -> None:
    """Lay a wood: dense large trees and a winding path.

    ``conifers`` are the least and the largest share of conifers.
    """
    rng = builder.rng
    frame = block.front(1)
    length, depth = block.length, block.depth
    builder.paint("grass", frame.quad(0, length, 0, depth), float(rng.uniform(0, 0.4)))
    t = np.linspace(0, 1, 25)
    start, end = rng.uniform(0.2, 0.8, 2) * length
    bend = rng.uniform(-0.1, 0.1) * length * np.sin(2 * np.pi * t)
    path = frame.point(start + t * (end - start) + bend, -1.5 + t * (depth + 3.0))
    builder.paint("path", ribbon(path, 1.8), float(rng.random()))
    for p, q in pairwise(path):
        builder.reserve(ribbon(np.stack([p, q]), 2.0))
    share = rng.uniform(*conifers)
    for _ in range(int(0.03 * length * depth)):
        a, b = rng.uniform(0, length), rng.uniform(0, depth)
        tree(builder, frame.point(a, b), rng.uniform(2.2, 5.0), share)


def meadow(builder: PlaceBuilder, block: Block) -> None:
    """Lay a meadow: open grass, clumps of trees, and tables in their shade."""
    rng = builder.rng
    frame = block.front(1)
    length, depth = block.length, block.depth
    builder.paint("grass", frame.quad(0, length, 0, depth), float(rng.random()))
    for _ in range(1 + int(length * depth / 2500)):
        a, b = rng.uniform(6, length - 6), rng.uniform(6, depth - 6)
        small_object(builder, "table", frame.point(a, b), rng.uniform(-np.pi, np.pi))
        small_object(builder, "bin", frame.point(a + 2.5, b), 0.0)
        for _ in range(5):
            spot = frame.point(a + rng.normal(0, 7), b + rng.normal(0, 7))
            tree(builder, spot, rng.uniform(1.8, 4.2), conifers=0.2)
