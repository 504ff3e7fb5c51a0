"""Build industrial blocks: halls, yards and car parks.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

import numpy as np

from simulate.place.builder import PAVEMENT_M, ObjectSpec, PlaceBuilder
from simulate.place.objects import (
    CONTAINER_M,
    building,
    place_fences,
    small_object,
    steel_colour,
    tree,
    truck,
)
from simulate.place.parking import AISLE_M, BAY_M, car_park
from simulate.place.streets import Block
from simulate.place.styles import hall_style


def halls(builder: PlaceBuilder, block: Block) -> None:
    """Place one or two halls, a car park in front, and containers and lorries beside them."""
    rng = builder.rng
    frame = block.front(int(rng.choice([1, -1])))
    length, depth = block.length, block.depth
    builder.paint("parking", frame.quad(0, length, 0, depth), float(rng.random()))
    builder.paint("parking", frame.quad(0.35 * length, 0.35 * length + 7, -PAVEMENT_M - 1, 1), 0.4)
    rows = 2 if depth > 66 else 1
    lot_depth = rows * (2 * BAY_M[1] + AISLE_M)
    car_park(builder, frame.shift(2.0, 2.5), 0.86 * length, rows)

    b0, b1 = lot_depth + 5.0, depth - 2.0
    count = 2 if length > 52 and builder.chance(0.5) else 1
    hall_end = 0.66 * length
    for i in range(count):
        hall_width = hall_end / count
        style = hall_style(builder)
        a, b = 1.5 + (i + 0.5) * hall_width, 0.5 * (b0 + b1)
        height = rng.uniform(5.5, 8.0) + style.roof_height_m
        size = (hall_width - 3.0, min(b1 - b0, rng.uniform(18.0, 34.0)), height)
        building(builder, "hall", frame, (a, b), size, style)

    # The yard has rows of containers, and lorries where there is room.
    yard0, yard1 = hall_end + 3.0, length - 1.0
    for b in np.arange(b1 - 1.5, b0 + 1.5, -2.9):
        shape = "long_container" if yard1 - yard0 > 13.5 and builder.chance(0.4) else "container"
        size = CONTAINER_M[shape]
        a = yard0 + 0.5 * size[0]
        while a + 0.5 * size[0] < yard1:
            if builder.chance(0.55):
                yaw = frame.yaw(a, b) + rng.normal(0, 0.015)
                builder.place(
                    ObjectSpec("container", shape, size, steel_colour(builder)),
                    frame.point(a, b),
                    yaw,
                )
            a += size[0] + 0.6
    for _ in range(12):
        a, b = rng.uniform(yard0, yard1), rng.uniform(lot_depth + 3.5, b1)
        truck(builder, frame.point(a, b), frame.yaw(a, b) + rng.choice([0.0, np.pi / 2]))
    for a in np.arange(3.0, length, 9.0):
        tree(builder, frame.point(a, 1.2), rng.uniform(0.9, 1.6))


def factory(builder: PlaceBuilder, block: Block) -> None:
    """Place a factory hall behind a car park, and a fenced yard with pallets and containers."""
    rng = builder.rng
    frame = block.front(int(rng.choice([1, -1])))
    length, depth = block.length, block.depth
    builder.paint("parking", frame.quad(0, length, 0, depth), float(rng.random()))
    builder.paint("parking", frame.quad(0.3 * length, 0.3 * length + 7, -PAVEMENT_M - 1, 1), 0.4)
    lot_depth = 2 * BAY_M[1] + AISLE_M
    car_park(builder, frame.shift(2.0, 2.0), 0.6 * length, rows=1)
    b0, b1 = lot_depth + 5.0, depth - 2.5
    count = 1 + int(0.58 * length > 40.0)
    for i in range(count):
        hall_width = 0.58 * length / count
        style = hall_style(builder)
        size = (
            hall_width - 3.0,
            min(b1 - b0 - 2.0, 45.0),
            rng.uniform(7, 11) + style.roof_height_m,
        )
        spot = (2.0 + (i + 0.5) * hall_width, 0.5 * (b0 + b1))
        building(builder, "hall", frame, spot, size, style)
    for a in np.arange(3.0, 0.58 * length, 7.0):
        small_object(builder, "bollard", frame.point(a, b0 - 1.2), frame.yaw(a, b0))

    yard0, yard1 = 0.66 * length, length - 2.0
    for b in np.arange(0.55 * depth, b1, 2.2):
        for a in np.arange(yard0, yard1, 2.0):
            if builder.chance(0.35):
                small_object(
                    builder, "pallet", frame.point(a, b), frame.yaw(a, b) + rng.normal(0, 0.06)
                )
    for _ in range(8):
        a, b = rng.uniform(yard0 + 3, yard1 - 3), rng.uniform(4, 0.5 * depth)
        if builder.chance(0.6):
            truck(builder, frame.point(a, b), frame.yaw(a, b) + np.pi / 2)
        else:
            shape = "container"
            yaw = frame.yaw(a, b)
            container = ObjectSpec("container", shape, CONTAINER_M[shape], steel_colour(builder))
            builder.place(container, frame.point(a, b), yaw)
    place_fences(builder, frame, length, depth, 2.0)


def tank_farm(builder: PlaceBuilder, block: Block) -> None:
    """Place rows of tanks on concrete inside a fence, and waiting lorries."""
    rng = builder.rng
    frame = block.front(1)
    length, depth = block.length, block.depth
    builder.paint("pavement", frame.quad(0, length, 0, depth), float(rng.random()))
    builder.paint("parking", frame.quad(0, length, 0, 11), float(rng.random()))
    builder.paint("parking", frame.quad(3, 10, -PAVEMENT_M - 1, 1), 0.4)
    for b in np.arange(16.0, depth - 4.5, 9.0):
        for a in np.arange(5.5, length - 4.5, 9.0):
            if builder.chance(0.8):
                small_object(builder, "tank", frame.point(a, b), rng.uniform(-np.pi, np.pi))
    for a in np.arange(7.0, length - 5.0, 10.0):
        if builder.chance(0.5):
            truck(builder, frame.point(a, 5.0), frame.yaw(a, 5.0))
    place_fences(builder, frame, length, depth, 2.0)
