"""Build blocks of a city centre: perimeter blocks around a court, and paved squares.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from simulate.place.builder import PAVEMENT_M, Footing, ObjectSpec, PlaceBuilder
from simulate.place.objects import bench, small_object, tree
from simulate.place.parking import AISLE_M, BAY_M, car_park
from simulate.place.streets import Block
from simulate.place.styles import front_style

_SETBACK_M = 0.35  # distance from the edge of the block to the fronts
_DEPTH_M = 11.0  # depth of the buildings
_PASSAGE_M = 4.2  # width of the passage into the court


def fronts(builder: PlaceBuilder, block: Block) -> None:
    """Place buildings wall to wall along all four streets, around a court with parked cars."""
    length, depth = block.length, block.depth
    builder.paint("pavement", block.front(1).quad(-1.2, length + 1.2, -1.2, depth + 1.2), 0.6)
    inner = _SETBACK_M + _DEPTH_M
    for side in (1, -1):
        # The only passage leads through the row along the first street.
        passage_m = builder.rng.uniform(0.4, 0.6) * length if side > 0 else None
        _row(builder, block, side, 0.0, (_SETBACK_M, length - _SETBACK_M), passage_m)
    for side in (1, -1):
        span = (inner + 0.1, depth - inner - 0.1)
        _row(builder, block, side, 0.5 * np.pi, span, None)
    court = length - 2 * inner - 2.0, depth - 2 * inner - 2.0
    if court[0] > 3 * BAY_M[0] and court[1] > 2 * BAY_M[1] + AISLE_M:
        middle = 0.5 * (depth - 2 * BAY_M[1] - AISLE_M)
        car_park(builder, block.front(1).shift(inner + 1.0, middle), court[0], rows=1)
    for share in builder.rng.uniform(0.2, 0.8, (6, 2)):
        spot = block.front(1).point(*(share * (length, depth)))
        tree(builder, spot, builder.rng.uniform(1.2, 2.2))


def _row(
    builder: PlaceBuilder,
    block: Block,
    side: int,
    turn: float,
    span: tuple[float, float],
    passage_m: float | None,
) -> None:
    """Place buildings along one street of a block.

    ``turn`` is 0 for a street along the block's length and a quarter turn for one along its depth.
    ``span`` is the first and the last metre of the buildings along the street.
    ``passage_m`` is the position of the passage in metres, or None.
    """
    frame = block.front(side)
    start, end = span
    corners = [start]
    while end - corners[-1] > 15.0:
        corners.append(corners[-1] + float(builder.rng.uniform(9.0, 15.0)))
    corners.append(end)
    for first, last in pairwise(corners):
        if passage_m is not None and first <= passage_m < last:
            lane = frame.quad(first, first + _PASSAGE_M, -PAVEMENT_M - 0.8, _DEPTH_M + 3.0)
            builder.paint("driveway", lane, float(builder.rng.random()))
            first += _PASSAGE_M
        if last - first < 4.0:
            continue
        floors = int(builder.rng.integers(3, 6))
        style = front_style(builder, floors)
        height = 2.8 * floors + 0.6 + style.roof_height_m
        along, across = 0.5 * (first + last), _SETBACK_M + 0.5 * _DEPTH_M
        a, b = (along, across) if turn == 0 else (across, along)
        # Where the street bends there may be less room; narrower buildings leave a gap there.
        for share in (1.0, 0.985, 0.96, 0.93, 0.88, 0.8):
            size = ((last - first) * share - 0.02, _DEPTH_M * (0.5 + 0.5 * share), height)
            yaw = frame.yaw(a, b) + turn
            front = ObjectSpec("building", "front", size, style=style)
            if builder.place(front, frame.point(a, b), yaw, Footing(gap_m=0.0)):
                break


def square(builder: PlaceBuilder, block: Block) -> None:
    """Lay a paved square with rows of trees, and benches, bins and bollards between them."""
    rng = builder.rng
    frame = block.front(1)
    length, depth = block.length, block.depth
    builder.paint(
        "pavement", frame.quad(-1.2, length + 1.2, -1.2, depth + 1.2), float(rng.random())
    )
    lawn = frame.quad(0.3 * length, 0.7 * length, 0.3 * depth, 0.7 * depth)
    builder.paint("grass", lawn, float(rng.random()))
    for a in np.arange(4.0, length - 3.0, 7.5):
        for b in np.arange(4.0, depth - 3.0, 7.5):
            tree(builder, frame.point(a, b), rng.uniform(1.8, 2.6), conifers=0.0)
            if builder.chance(0.4):
                bench(builder, frame.point(a + 3.7, b), frame.yaw(a, b))
    for a in np.arange(1.5, length - 1.0, 6.0):
        for b in (0.5, depth - 0.5):
            small_object(builder, "bollard", frame.point(a, b), frame.yaw(a, b))
    for a in (0.25 * length, 0.75 * length):
        small_object(builder, "bin", frame.point(a, 0.5 * depth), frame.yaw(a, 0.5 * depth))
