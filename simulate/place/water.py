"""Build blocks with still water: a lake in a park, and a dock.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from simulate.place.builder import PAVEMENT_M, Footing, ObjectSpec, PlaceBuilder
from simulate.place.objects import CONTAINER_M, bench, small_object, steel_colour, tree, truck
from simulate.place.streets import Block
from simulate.place.world import ribbon

_WATER_FOOTING = Footing(on_reserved=True, gap_m=0.4)
_STRIPS = 10  # number of strips that reserve the ground under an ellipse of water


def lake(builder: PlaceBuilder, block: Block) -> None:
    """Lay a lake with boats, trees, and a path around it with benches, tables and bins."""
    rng = builder.rng
    frame = block.front(1)
    length, depth = block.length, block.depth
    builder.paint("grass", frame.quad(0, length, 0, depth), float(rng.random()))
    bank = 4.0
    land = bank + 1.5 * builder.terrain.spacing_m + 1.0  # from the shore to the block's edge
    half_a, half_b = (0.5 * side - land for side in (length, depth))
    if min(half_a, half_b) < 5.0:
        return
    middle = 0.5 * length, 0.5 * depth
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    phase = rng.uniform(0, 2 * np.pi, 2)
    reach = 0.87 + 0.08 * np.sin(2 * turn + phase[0]) + 0.05 * np.sin(3 * turn + phase[1])
    circle = np.stack([np.cos(turn), np.sin(turn)])
    shore = frame.point(
        middle[0] + half_a * reach * circle[0], middle[1] + half_b * reach * circle[1]
    )
    builder.flood(shore, bank)
    for low, high in pairwise(np.linspace(-1, 1, _STRIPS + 1)):
        half_width = half_a * np.sqrt(1 - min(low * low, high * high))
        b0, b1 = middle[1] + half_b * low, middle[1] + half_b * high
        builder.reserve(frame.quad(middle[0] - half_width, middle[0] + half_width, b0, b1))

    for _ in range(3 + int(half_a * half_b / 250)):
        a, b = (
            middle[0] + rng.uniform(-0.5, 0.5) * half_a,
            middle[1] + rng.uniform(-0.5, 0.5) * half_b,
        )
        small_object(builder, "boat", frame.point(a, b), rng.uniform(-np.pi, np.pi), _WATER_FOOTING)

    a, b = (middle[i] + (half + 2.2) * circle[i] for i, half in enumerate((half_a, half_b)))
    path = frame.point(np.append(a, a[0]), np.append(b, b[0]))
    builder.paint("path", ribbon(path, 2.0), float(rng.random()))
    for p, q in pairwise(path):
        builder.reserve(ribbon(np.stack([p, q]), 2.2))
    kinds = ("bench", "table", "bench", "bin")
    for k in range(0, len(turn), 3):
        offset = np.array([half_a + 4.6, half_b + 4.6]) * circle[:, k]
        spot = frame.point(middle[0] + offset[0], middle[1] + offset[1])
        along = path[k + 1] - path[k]
        yaw = float(np.arctan2(along[1], along[0]))
        kind = kinds[k // 3 % len(kinds)]
        if kind == "bench":  # faces the water
            bench(builder, spot, yaw + np.pi)
        else:
            small_object(builder, kind, spot, yaw)
    for _ in range(int(0.02 * length * depth)):
        tree(
            builder,
            frame.point(rng.uniform(0, length), rng.uniform(0, depth)),
            rng.uniform(1.8, 4.0),
        )


def dock(builder: PlaceBuilder, block: Block) -> None:
    """Lay a basin with boats between quays with bollards, containers and lorries."""
    rng = builder.rng
    frame = block.front(1)
    length, depth = block.length, block.depth
    builder.paint("parking", frame.quad(0, length, 0, depth), float(rng.random()))
    builder.paint("parking", frame.quad(4, 11, -PAVEMENT_M - 1, 1), 0.4)
    quay = 3.0
    land = quay + 1.5 * builder.terrain.spacing_m + 0.5  # from the basin to the block's edge
    a0, a1, b0, b1 = land, length - land, 0.42 * depth, depth - land
    if b1 - b0 < 8.0:
        return
    basin = frame.quad(a0, a1, b0, b1)
    builder.flood(basin, quay)
    builder.reserve(basin)
    for _ in range(4 + int((a1 - a0) * (b1 - b0) / 300)):
        a, b = rng.uniform(a0 + 3, a1 - 3), rng.uniform(b0 + 3, b1 - 3)
        yaw = frame.yaw(a, b) + builder.choose((0.0, np.pi)) + rng.normal(0, 0.15)
        small_object(builder, "boat", frame.point(a, b), yaw, _WATER_FOOTING)
    for a in np.arange(a0 + 1.0, a1, 6.0):
        for b in (b0 - 0.7, b1 + 0.7):
            small_object(builder, "bollard", frame.point(a, b), frame.yaw(a, b))
    size = CONTAINER_M["container"]
    for b in np.arange(2.5, b0 - 5.5, 2.9):
        for a in np.arange(16.0, length - 4.0, size[0] + 0.6):
            if builder.chance(0.6):
                yaw = frame.yaw(a, b) + rng.normal(0, 0.015)
                container = ObjectSpec("container", "container", size, steel_colour(builder))
                builder.place(container, frame.point(a, b), yaw)
    for _ in range(8):
        a, b = rng.uniform(2, 14), rng.uniform(3, b0 - 3)
        truck(builder, frame.point(a, b), frame.yaw(a, b) + np.pi / 2)
