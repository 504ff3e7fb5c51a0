"""Build blocks of orchards: equal trees at equal distances.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from simulate.place.builder import PAVEMENT_M, ObjectSpec, PlaceBuilder
from simulate.place.objects import place_fences, small_object, tree_spec
from simulate.place.streets import Block

_HEADLAND_M = 5.0  # width of the grass around the trees


@dataclass(frozen=True)
class Planting:
    """The trees of all orchards of a place.

    Attributes:
        row_spacing_m: Distance between rows.
        tree_spacing_m: Distance between trees of a row.
        cultivars: The kinds of trees; each orchard has one kind.
    """

    row_spacing_m: float
    tree_spacing_m: float
    cultivars: tuple[ObjectSpec, ...]


def draw_planting(builder: PlaceBuilder) -> Planting:
    """Draw the distances and two kinds of trees."""
    rng = builder.rng
    spacing_m = rng.uniform(3.6, 4.8)
    radius = 0.45 * spacing_m
    cultivars = tuple(tree_spec(builder, radius * share, 0.0) for share in (1.0, 0.8))
    return Planting(spacing_m + rng.uniform(1.0, 2.0), spacing_m, cultivars)


def orchard(builder: PlaceBuilder, block: Block) -> None:
    """Plant rows of equal trees on both sides of a farm track.

    Crates, and perhaps a tractor, stand beside the track.
    """
    planting = builder.once(draw_planting)
    rng, frame = builder.rng, block.front(1)
    length, depth = block.length, block.depth
    cultivar = builder.choose(planting.cultivars)
    builder.paint("grass", frame.quad(0, length, 0, depth), float(rng.random()))
    middle = 0.5 * length
    builder.reserve(frame.quad(middle - 2.2, middle + 2.2, -1.0, depth + 1.0))
    soil = float(rng.random())
    for b in np.arange(_HEADLAND_M, depth - _HEADLAND_M, planting.row_spacing_m):
        row = frame.quad(_HEADLAND_M - 1.0, length - _HEADLAND_M + 1.0, b - 0.6, b + 0.6)
        builder.paint("field", row, soil)
        for a in np.arange(_HEADLAND_M, length - _HEADLAND_M, planting.tree_spacing_m):
            if builder.chance(0.97):  # else the tree was felled
                size = np.multiply(cultivar.size, rng.uniform(0.93, 1.07)).tolist()
                yaw = rng.uniform(-np.pi, np.pi)
                builder.place(replace(cultivar, size=size), frame.point(a, b), yaw)
    track = frame.quad(middle - 1.5, middle + 1.5, -PAVEMENT_M - 1.0, depth + PAVEMENT_M + 1.0)
    builder.paint("path", track, float(rng.random()))
    for _ in range(int(rng.integers(2, 6))):
        a = middle + rng.choice([-2.8, 2.8])
        b = rng.choice([1.5, depth - 1.5]) + rng.normal(0, 0.5)
        small_object(builder, "pallet", frame.point(a, b), rng.uniform(-np.pi, np.pi))
    if builder.chance(0.3):
        b = rng.uniform(4, depth - 4)
        position = frame.point(middle + 2.9, b)
        small_object(builder, "tractor", position, frame.yaw(middle, b) + np.pi / 2)
    if builder.chance(0.35):
        place_fences(builder, frame, length, depth, rng.uniform(1.2, 1.8))
