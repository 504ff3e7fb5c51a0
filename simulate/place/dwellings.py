"""Build residential blocks: houses on parcels, and blocks of flats.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

import numpy as np

from simulate.place.builder import PAVEMENT_M, ObjectSpec, PlaceBuilder
from simulate.place.objects import STEEL_COLOURS, Local, Size, barrier, bench, building, car, tree
from simulate.place.parking import AISLE_M, BAY_M, car_park
from simulate.place.streets import Block, StreetFrame
from simulate.place.styles import house_style, shed_style, slab_style


def housing(builder: PlaceBuilder, block: Block) -> None:
    """Lay two rows of parcels back to back, each with a house, a drive and a garden."""
    depth = 0.5 * block.depth
    for side in (1, -1):
        count = max(1, round(block.length / builder.rng.uniform(14.5, 19.0)))
        width = block.length / count
        for i in range(count):
            parcel = block.front(side).shift(i * width)
            _parcel(builder, parcel, width, depth, back_line=side > 0, last=i == count - 1)


def _parcel(
    builder: PlaceBuilder,
    frame: StreetFrame,
    width: float,
    depth: float,
    *,
    back_line: bool,
    last: bool,
) -> None:
    """Lay one parcel of ``width`` x ``depth`` metres: house, drive, outbuildings, garden, barriers.

    Hedges or fences stand at its first side, with ``last`` at the other side too, and with
    ``back_line`` at its back, so that neighbours share them.
    """
    rng = builder.rng
    builder.paint("grass", frame.quad(0, width, 0, depth), float(rng.random()))
    # The drive runs along one side of the parcel, and the house takes the rest of the width.
    left = builder.chance(0.5)
    house_width = min(width - 6.2, rng.uniform(8.5, 12.5))
    house_depth = min(0.45 * depth, rng.uniform(7.5, 10.5))
    setback = rng.uniform(3.5, min(7.0, 0.3 * depth))
    drive_a = 2.5 if left else width - 2.5
    house_a = (4.9 + width - 0.9) / 2 if left else (width - 4.9 + 0.9) / 2
    drive_end = setback + rng.uniform(0.3, 0.8) * house_depth
    lane = frame.quad(drive_a - 1.5, drive_a + 1.5, -PAVEMENT_M - 0.8, drive_end)
    door_a = house_a + rng.uniform(-0.25, 0.25) * house_width
    walk = frame.quad(door_a - 0.6, door_a + 0.6, -0.6, setback + 1.0)
    builder.paint("driveway", lane, float(rng.random()))
    builder.paint("path" if builder.chance(0.4) else "pavement", walk, float(rng.random()))

    b = setback + 0.5 * house_depth
    style = house_style(builder, house_width, house_depth)
    height = 2.8 * style.floors + 0.4 + style.roof_height_m
    building(builder, "house", frame, (house_a, b), (house_width, house_depth, height), style)
    house_end = setback + house_depth
    patio_depth = rng.uniform(2.5, 4.5)
    a0 = house_a + rng.uniform(-0.4, 0.0) * house_width
    terrace = frame.quad(a0, a0 + 4.0, house_end - 0.5, house_end + patio_depth)
    builder.paint("pavement", terrace, float(rng.random()))

    if builder.chance(0.45):
        b = drive_end + 3.2
        outbuilding(builder, frame, (drive_a, b), (3.0, 6.0, 2.7))
    builder.reserve(frame.quad(drive_a - 1.4, drive_a + 1.4, -0.5, drive_end - 0.2))
    if builder.chance(0.6):
        yaw = frame.yaw(drive_a, 2.8) + np.pi / 2 * builder.choose((1, -1))
        car(builder, frame.point(drive_a, 2.8), yaw)
    if builder.chance(0.4):
        a = 2.2 if builder.chance(0.5) else width - 2.2
        outbuilding(builder, frame, (a, depth - 2.4), (2.6, 2.2, 2.3))

    runs = [((0.0, 0.6), (0.0, depth - 0.6))]
    if last:
        runs.append(((width, 0.6), (width, depth - 0.6)))
    if back_line:
        runs.append(((0.7, depth), (width - 0.7, depth)))
    gaps = [(drive_a - 1.7, drive_a + 1.7), (door_a - 0.8, door_a + 0.8)]
    barrier_start = _enclose(builder, frame, width, runs, gaps)

    _plant_garden(builder, frame, (width, depth), house_end, barrier_start)


def _plant_garden(
    builder: PlaceBuilder, frame: StreetFrame, size: Local, house_end: float, barrier_start: float
) -> None:
    """Place trees behind a house, and perhaps a tree in front of it and a bench at its back.

    Args:
        builder: place that is built.
        frame: frame of the parcel.
        size: width and depth of the parcel, metres.
        house_end: distance of the house's back from the street, metres.
        barrier_start: start of the last hedge or fence, metres along the street.
    """
    rng, (width, depth) = builder.rng, size
    for _ in range(int(rng.integers(6, 22))):
        a, b = rng.uniform(1.5, width - 1.5), rng.uniform(house_end + 1.5, depth - 1.2)
        tree(builder, frame.point(a, b), rng.uniform(0.6, 3.4), conifers=0.2)
    if builder.chance(0.6):
        front = frame.point(rng.uniform(1, width - 1), 2.0)
        tree(builder, front, rng.uniform(0.9, 1.8), conifers=0.2)
    if builder.chance(0.15):
        bench(
            builder,
            frame.point(barrier_start + 2.0, house_end + 1.2),
            frame.yaw(barrier_start, house_end),
        )


def _enclose(
    builder: PlaceBuilder,
    frame: StreetFrame,
    width: float,
    runs: list[tuple[Local, Local]],
    gaps: list[Local],
) -> float:
    """Place hedges or fences along some sides of a parcel, and perhaps along its street.

    Args:
        builder: place that is built.
        frame: frame of the parcel.
        width: width of the parcel along the street, metres.
        runs: first and last local point of each side.
        gaps: first and last metre along the street that stay open for the drive and the walk.

    Returns:
        Start of the last hedge or fence, metres along the street.
    """
    rng = builder.rng
    kind, hedge = ("hedge", True) if builder.chance(0.55) else ("fence", False)
    section = (0.8, rng.uniform(1.1, 1.9)) if hedge else (0.10, rng.uniform(1.0, 1.8))
    street: list[tuple[Local, Local]] = []
    if builder.chance(0.45):
        start = 0.7
        for first, last in [*sorted(gaps), (width - 0.7, width)]:
            street.append(((start, 0.1), (first, 0.1)))
            start = last
    for start_at, end_at in [*runs, *street]:
        barrier(builder, kind, frame, start_at, end_at, section)
    return start_at[0]


def outbuilding(builder: PlaceBuilder, frame: StreetFrame, spot: Local, size: Size) -> None:
    """Place a garage or a shed."""
    style = shed_style(builder)
    building(builder, "shed", frame, spot, size, style)


def flats(builder: PlaceBuilder, block: Block) -> None:
    """Place two rows of flats that face the streets, with a car park between them."""
    rng = builder.rng
    builder.paint(
        "grass", block.front(1).quad(0, block.length, 0, block.depth), float(rng.random())
    )
    strip = 2 * BAY_M[1] + AISLE_M
    middle = 0.5 * block.depth
    for side in (1, -1):
        frame = block.front(side)
        room = middle - 0.5 * strip - 2.0
        depth = min(12.0, room - 3.5)
        if depth < 6.5:
            continue
        setback = 0.5 * (room - depth) + 0.5
        count = max(1, round(block.length / rng.uniform(26, 42)))
        floors = int(rng.integers(3, 6))
        for i in range(count):
            spacing = block.length / count
            a, b = (i + 0.5) * spacing, setback + 0.5 * depth
            style = slab_style(builder, floors)
            size = (spacing - rng.uniform(5, 9), depth, 2.9 * floors + 0.4 + style.roof_height_m)
            building(builder, "slab", frame, (a, b), size, style)
            walk = frame.quad(a - 0.9, a + 0.9, -0.6, setback + 1.0)
            builder.paint("pavement", walk, float(rng.random()))
            builder.reserve(walk)
            bench(builder, frame.point(a + 3.0, setback - 1.2), frame.yaw(a, 0))
    frame = block.front(1)
    lot_start = 4.0
    length = block.length - lot_start - 4.0
    exit_ = frame.quad(-PAVEMENT_M - 1.0, lot_start + 1, middle - 3, middle + 3)
    builder.paint("parking", exit_, 0.5)
    car_park(builder, frame.shift(lot_start, middle - 0.5 * strip), length, rows=1)
    for a in (1.2, block.length - 2.0):
        b = middle + rng.uniform(3.5, 6.0)
        skip = ObjectSpec("container", "skip", (3.2, 1.7, 1.35), builder.choose(STEEL_COLOURS))
        builder.place(skip, frame.point(a, b), frame.yaw(a, b) + np.pi / 2)
    for _ in range(45):
        a, b = rng.uniform(2, block.length - 2), rng.uniform(1, block.depth - 1)
        tree(builder, block.front(1).point(a, b), rng.uniform(1.4, 3.6))
