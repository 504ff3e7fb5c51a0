"""Build blocks of a solar park: rows of tilted panels on grass, inside a fence.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulate.place.builder import PAVEMENT_M, ObjectSpec, PlaceBuilder
from simulate.place.objects import building, place_fences, small_object, van
from simulate.place.streets import Block
from simulate.place.styles import shed_style
from simulate.place.world import Rgb

# Linear albedo of cells: blue polycrystalline, black monocrystalline, brown thin film.
_CELLS: tuple[Rgb, ...] = ((0.012, 0.024, 0.075), (0.010, 0.012, 0.018), (0.030, 0.020, 0.018))
_LOW_EDGE_M = 0.8  # height of the panels' lower edge
_SETBACK_M = 2.5  # distance of the panels from the fence


@dataclass(frozen=True)
class PanelArray:
    """The panels of a place: one table of them, and the distances between tables.

    Attributes:
        table: A table of panels. Its length runs along the row, and it faces its -y side.
        row_spacing_m: Distance between rows.
        gap_m: Distance between tables of a row.
    """

    table: ObjectSpec
    row_spacing_m: float
    gap_m: float


def draw_array(builder: PlaceBuilder) -> PanelArray:
    """Draw size, tilt and colour of the tables, and the distances between them."""
    rng = builder.rng
    length, slope = rng.uniform(6.0, 12.0), rng.uniform(3.2, 5.2)
    tilt = np.radians(rng.uniform(15.0, 30.0))
    depth, rise = slope * np.cos(tilt), slope * np.sin(tilt)
    size = (length, float(depth), float(_LOW_EDGE_M + rise))
    shape = "panel" if builder.chance(0.5) else "wide_panel"
    table = ObjectSpec("panel", shape, size, builder.choose(_CELLS))
    return PanelArray(table, float(depth + rise * rng.uniform(1.4, 2.4)), rng.uniform(0.3, 0.9))


def solar(builder: PlaceBuilder, block: Block) -> None:
    """Place rows of panels on both sides of a service track, with inverters and a transformer."""
    array = builder.once(draw_array)
    rng, frame = builder.rng, block.front(1)
    length, depth = block.length, block.depth
    builder.paint("grass", frame.quad(0, length, 0, depth), float(rng.random()))
    middle = rng.uniform(0.35, 0.65) * length
    track = frame.quad(middle - 1.8, middle + 1.8, -PAVEMENT_M - 1.0, depth - 3.0)
    builder.paint("path", track, float(rng.random()))
    builder.reserve(track)
    style = shed_style(builder)
    building(builder, "shed", frame, (middle + 5.0, 2.6), (6.0, 3.0, 3.0), style)
    if builder.chance(0.4):
        van(builder, frame.point(middle, 4.0), frame.yaw(middle, 4.0) + np.pi / 2)

    step = array.table.size[0] + array.gap_m
    for number, b in enumerate(
        np.arange(_SETBACK_M + 2.5, depth - _SETBACK_M, array.row_spacing_m)
    ):
        for direction, first, room in (
            (1, middle + 5.0, length - middle - 5.0 - _SETBACK_M),
            (-1, middle - 2.5, middle - 2.5 - _SETBACK_M),
        ):
            for k in range(int(room / step)):
                a = first + direction * (k + 0.5) * step
                builder.place(array.table, frame.point(a, b), frame.yaw(a, b))
        if number % 4 == 1:
            a = middle + 3.4
            small_object(builder, "cabinet", frame.point(a, b), frame.yaw(a, b))
    place_fences(builder, frame, length, depth, 2.2)
