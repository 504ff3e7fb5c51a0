"""Build blocks of a harbour: quays with ships, sheds and cranes, and basins with moored yachts.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

import numpy as np

from simulate.place.builder import PAVEMENT_M, Footing, ObjectSpec, PlaceBuilder
from simulate.place.objects import CRANE_M, building, car, small_object, truck
from simulate.place.parking import AISLE_M, BAY_M, car_park
from simulate.place.streets import Block, StreetFrame
from simulate.place.styles import hall_style, vary
from simulate.place.world import Rgb

_WATER_FOOTING = Footing(on_reserved=True, gap_m=0.3)
_BANK_M = 3.0  # width of the ground that slopes to the water
_HULL_COLOURS: tuple[Rgb, ...] = (
    (0.02, 0.05, 0.12),
    (0.22, 0.03, 0.025),
    (0.03, 0.10, 0.05),
    (0.05,) * 3,
)
_YACHT_COLOURS: tuple[Rgb, ...] = ((0.62, 0.62, 0.60), (0.55, 0.56, 0.58), (0.03, 0.06, 0.16))


def _basin(builder: PlaceBuilder, block: Block, front_m: float) -> tuple[float, ...] | None:
    """Flood a block behind ``front_m`` metres of quay.

    Return the local bounds (a0, a1, b0, b1) of the basin; None if there is no room for it.
    """
    frame, length, depth = block.front(1), block.length, block.depth
    tone = float(builder.rng.random())
    builder.paint("parking", frame.quad(0, length, 0, depth), tone)
    builder.paint("parking", frame.quad(4, 11, -PAVEMENT_M - 1, 1), tone)
    land = _BANK_M + 1.5 * builder.terrain.spacing_m + 0.5  # from the water to the block's edge
    a0, a1, b0, b1 = land, length - land, front_m, depth - land
    if min(a1 - a0, b1 - b0) < 16.0:
        return None
    water = frame.quad(a0, a1, b0, b1)
    builder.flood(water, _BANK_M)
    builder.reserve(water)
    for a in np.arange(a0 + 1.0, a1, 7.0):
        for b in (b0 - 0.7, b1 + 0.7):
            small_object(builder, "bollard", frame.point(a, b), frame.yaw(a, b))
    return a0, a1, b0, b1


def quay(builder: PlaceBuilder, block: Block) -> None:
    """Place ships along a quay with a crane, sheds, pallets and trucks."""
    rng, frame = builder.rng, block.front(1)
    front_m = min(36.0, 0.42 * block.depth)
    basin = _basin(builder, block, front_m)
    if basin is None:
        return
    a0, a1, b0, b1 = basin
    for b in (b0 + 7.0, b1 - 7.0):
        a = a0 + rng.uniform(2.0, 8.0)
        while True:
            length = min(rng.uniform(32.0, 58.0), a1 - a0 - 10.0)
            if a + length > a1 - 1.0:
                break
            hull = vary(builder, builder.choose(_HULL_COLOURS))
            size = (length, 0.17 * length + 1.5, 0.16 * length + 2.0)
            ship = ObjectSpec("boat", "ship", size, hull)
            at = a + 0.5 * length
            yaw = frame.yaw(at, b) + builder.choose((0.0, np.pi))
            builder.place(ship, frame.point(at, b), yaw, _WATER_FOOTING)
            a += length + rng.uniform(3.0, 14.0)
    a = rng.uniform(0.25, 0.75) * block.length
    crane = ObjectSpec("crane", "gantry", (CRANE_M[0], 11.0, CRANE_M[2]), (0.05, 0.16, 0.30))
    builder.place(crane, frame.point(a, b0 - 8.0), frame.yaw(a, b0 - 8.0))
    _sheds(builder, frame, block.length, front_m - 16.0)
    for a in np.arange(3.0, block.length - 3.0, 2.4):
        if builder.chance(0.35):
            b = b0 - 11.0 + rng.normal(0, 1.0)
            small_object(builder, "pallet", frame.point(a, b), frame.yaw(a, b))
    for a in rng.uniform(6.0, block.length - 6.0, 3):
        truck(builder, frame.point(a, b0 - 4.0), frame.yaw(float(a), b0) + rng.choice([0.0, np.pi]))


def _sheds(builder: PlaceBuilder, frame: StreetFrame, length: float, depth: float) -> None:
    """Place a row of equal sheds along the water."""
    if depth < 10.0:
        return
    rng = builder.rng
    style = hall_style(builder)
    count = max(1, int((length - 16.0) / rng.uniform(15.0, 24.0)))
    width = (length - 16.0) / count
    size = (width - 1.5, depth - 5.0, 5.5 + style.roof_height_m)
    for k in range(count):
        building(builder, "hall", frame, (14.0 + (k + 0.5) * width, 0.5 * depth + 1.0), size, style)


def marina(builder: PlaceBuilder, block: Block) -> None:
    """Place yachts along pontoons, and a car park on the quay."""
    rng, frame = builder.rng, block.front(1)
    car_park(builder, frame.shift(2.0, 2.5), block.length - 4.0, rows=1)
    basin = _basin(builder, block, 2 * BAY_M[1] + AISLE_M + 9.0)
    if basin is None:
        return
    a0, a1, b0, b1 = basin
    berth = rng.uniform(9.0, 13.0)
    spacing = 2 * berth + 9.0
    for a in np.arange(a0 + berth + 2.0, a1 - berth - 1.0, spacing):
        end = b1 - rng.uniform(3.0, 9.0)
        pontoon = frame.quad(a - 1.0, a + 1.0, b0 - _BANK_M, end)
        builder.paint("pavement", pontoon, 0.8)
        for b in np.arange(b0 + 3.0, end - 2.0, 0.42 * berth):
            for side in (1, -1):
                if builder.chance(0.78):
                    _yacht(builder, frame, (float(a), float(b)), side, berth)
    for a in rng.uniform(4.0, block.length - 4.0, 4):
        car(builder, frame.point(a, b0 - 6.5), frame.yaw(float(a), b0))


def _yacht(
    builder: PlaceBuilder, frame: StreetFrame, spot: tuple[float, float], side: int, berth: float
) -> None:
    """Place a yacht on one side of a pontoon at ``spot``, with its stern to the pontoon."""
    length = builder.rng.uniform(0.7, 0.97) * berth
    shape, height = ("yacht", 1.25 * length) if builder.chance(0.7) else ("cruiser", 0.32 * length)
    colour = vary(builder, builder.choose(_YACHT_COLOURS))
    a = spot[0] + side * (1.6 + 0.5 * length)
    yaw = frame.yaw(a, spot[1]) + (0.0 if side > 0 else np.pi)
    boat = ObjectSpec("boat", shape, (length, 0.30 * length, height), colour)
    builder.place(boat, frame.point(a, spot[1]), yaw, _WATER_FOOTING)
