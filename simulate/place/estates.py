"""Build blocks of an estate of identical houses.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from simulate.place.builder import PAVEMENT_M, Footing, ObjectSpec, PlaceBuilder
from simulate.place.dwellings import outbuilding
from simulate.place.objects import barrier, car, tree
from simulate.place.streets import Block, StreetFrame
from simulate.place.styles import house_style, shed_style
from simulate.place.world import BuildingStyle, Roof

_WALL_TO_WALL = Footing(gap_m=0.0)
# Thickness and height of barriers, metres.
_SECTIONS = {"hedge": (0.8, 1.5), "fence": (0.10, 1.6)}


@dataclass(frozen=True)
class HouseType:
    """The house of an estate, with its garage and its plot.

    Attributes:
        plot_m: Width of a plot.
        size: Length, width and height of the house, metres.
        style: Style of the house.
        houses_per_row: Number of houses wall to wall between two gaps.
        setback_m: Distance of the house from the street.
        garage: Style of the garage beside the house. None makes a parking space in front of the
            house.
        barrier: Kind of the barriers between gardens.
        lawn: Tone of the lawns.
    """

    plot_m: float
    size: tuple[float, float, float]
    style: BuildingStyle
    houses_per_row: int
    setback_m: float
    garage: BuildingStyle | None
    barrier: Literal["hedge", "fence"]
    lawn: float


def draw_house_type(builder: PlaceBuilder) -> HouseType:
    """Draw detached houses with a garage, or terraces of four to seven houses."""
    rng = builder.rng
    terraced = builder.chance(0.5)
    width = rng.uniform(6.0, 7.5) if terraced else rng.uniform(8.5, 11.0)
    depth = rng.uniform(8.5, 10.5)
    style = house_style(builder, width, depth)
    if terraced:  # roofs and walls meet those of the neighbours
        roof: Roof = "flat" if style.roof == "flat" else "gable"
        style = replace(
            style, roof=roof, overhang_m=0.05, main_depth_share=1.0, wing_width_share=1.0
        )
    return HouseType(
        plot_m=width + (0.02 if terraced else rng.uniform(5.2, 6.5)),
        size=(width, depth, 2.8 * style.floors + 0.4 + style.roof_height_m),
        style=style,
        houses_per_row=int(rng.integers(4, 8)) if terraced else 1,
        setback_m=6.2 if terraced else rng.uniform(4.0, 6.5),
        garage=None if terraced else shed_style(builder),
        barrier="fence" if builder.chance(0.5) else "hedge",
        lawn=float(rng.random()),
    )


def estate(builder: PlaceBuilder, block: Block) -> None:
    """Lay two rows of equal plots back to back, each with the house type of the place."""
    kind = builder.once(draw_house_type)
    depth = 0.5 * block.depth
    gap = 0.0 if kind.houses_per_row == 1 else 4.0
    for side in (1, -1):
        frame = block.front(side)
        builder.paint("grass", frame.quad(0, block.length, 0, depth), kind.lawn)
        a, number = 0.5 * gap, 0
        while a + kind.plot_m <= block.length:
            _plot(builder, frame.shift(a), kind, depth)
            number += 1
            a += kind.plot_m + (gap if number % kind.houses_per_row == 0 else 0.0)
    frame, section = block.front(1), _SECTIONS[kind.barrier]
    for a in np.arange(1.0, block.length - 12.0, 11.0):
        barrier(builder, kind.barrier, frame, (a, depth), (a + 11.0, depth), section)


def _plot(builder: PlaceBuilder, frame: StreetFrame, kind: HouseType, depth: float) -> None:
    """Lay one plot: house, drive, walk and garden. Only cars, sheds and trees differ."""
    rng, (width, house_depth, _) = builder.rng, kind.size
    house_a = 0.5 * width
    drive_a = 0.5 * (width + kind.plot_m) if kind.garage is not None else 0.30 * width
    house_end = kind.setback_m + house_depth
    drive_end = kind.setback_m + 1.5 if kind.garage is not None else kind.setback_m - 0.4
    drive = frame.quad(drive_a - 1.4, drive_a + 1.4, -PAVEMENT_M - 0.8, drive_end)
    builder.paint("driveway", drive, 0.5)
    walk_a = 0.78 * width
    walk = frame.quad(walk_a - 0.6, walk_a + 0.6, -0.6, kind.setback_m + 0.5)
    builder.paint("pavement", walk, 0.5)
    terrace = frame.quad(0.2 * width, 0.7 * width, house_end - 0.5, house_end + 3.0)
    builder.paint("pavement", terrace, 0.5)

    house = ObjectSpec("building", "house", kind.size, style=kind.style)
    spot = frame.point(house_a, kind.setback_m + 0.5 * house_depth)
    builder.place(house, spot, frame.yaw(house_a, 0.0), _WALL_TO_WALL)
    if kind.garage is not None:
        garage = ObjectSpec("building", "shed", (2.9, 6.0, 2.7), style=kind.garage)
        position = frame.point(drive_a, drive_end + 3.0)
        builder.place(garage, position, frame.yaw(drive_a, 0.0))
    builder.reserve(frame.quad(drive_a - 1.3, drive_a + 1.3, -0.5, drive_end - 0.2))
    if builder.chance(0.6):
        b = min(2.8, 0.5 * drive_end)
        yaw = frame.yaw(drive_a, b) + np.pi / 2 * builder.choose((1, -1))
        car(builder, frame.point(drive_a, b), yaw, gap_m=0.05)
    if builder.chance(0.35):
        a = rng.choice([1.8, kind.plot_m - 1.8])
        outbuilding(builder, frame, (a, depth - 2.2), (2.4, 2.0, 2.2))
    edge = (kind.plot_m - 0.01, house_end + 0.3), (kind.plot_m - 0.01, depth - 0.6)
    barrier(builder, kind.barrier, frame, *edge, _SECTIONS[kind.barrier])
    garden = house_end + 3.5, max(house_end + 3.5, depth - 1.2)
    for _ in range(int(rng.integers(0, 4))):
        a, b = rng.uniform(1.2, kind.plot_m - 1.2), rng.uniform(*garden)
        tree(builder, frame.point(a, b), rng.uniform(0.6, 2.2), conifers=0.2)
