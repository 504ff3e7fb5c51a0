"""Build blocks of a container yard: stacks of containers in rows, with lanes between them.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulate.place.builder import PAVEMENT_M, Footing, ObjectSpec, PlaceBuilder
from simulate.place.objects import (
    CONTAINER_M,
    CRANE_M,
    STACKER_M,
    STEEL_COLOURS,
    small_object,
    truck,
)
from simulate.place.streets import Block, StreetFrame
from simulate.place.styles import vary
from simulate.place.world import Rgb

MAX_STACKED = 5
STACK_VARIANTS = 4
"""Number of meshes for each height of a stack, which differ in the colours of the containers below
the top."""

_STACK_SPACING_M = 2.44 + 0.36  # distance between the middles of stacks side by side
_GAP_M = 0.45  # distance between stacks end to end
_LANE_M = 8.0  # least width of the lane between two groups of rows
_EDGE_M = 4.5  # width of the lane around the yard
_CRANE_PAINTS: tuple[Rgb, ...] = ((0.45, 0.28, 0.02), (0.03, 0.10, 0.30))


@dataclass(frozen=True)
class Yard:
    """The stacks of a place.

    Attributes:
        shape: Name of the container's shape.
        rows: Number of rows side by side between two lanes.
        colours: Colours of the owners' containers.
        max_stacked: Maximum number of containers in a stack.
        occupied_share: Share of the positions with a stack.
    """

    shape: str
    rows: int
    colours: tuple[Rgb, ...]
    max_stacked: int
    occupied_share: float


def draw_yard(builder: PlaceBuilder) -> Yard:
    """Draw the containers, their owners' colours, and the height and density of the stacks."""
    rng = builder.rng
    owners = rng.permutation(len(STEEL_COLOURS))[: int(rng.integers(2, 5))]
    return Yard(
        shape="long_container" if builder.chance(0.5) else "container",
        rows=int(rng.integers(4, 7)),
        colours=tuple(vary(builder, STEEL_COLOURS[k]) for k in owners),
        max_stacked=int(rng.integers(3, MAX_STACKED + 1)),
        occupied_share=rng.uniform(0.8, 0.97),
    )


def container_yard(builder: PlaceBuilder, block: Block) -> None:
    """Place groups of rows of stacks, with a crane over each group and vehicles in the lanes."""
    yard = builder.once(draw_yard)
    rng, frame = builder.rng, block.front(1)
    length, depth = block.length, block.depth
    builder.paint("parking", frame.quad(-PAVEMENT_M, length, -PAVEMENT_M, depth), 0.5)
    builder.paint("parking", frame.quad(3, 11, -PAVEMENT_M - 1.5, 1), 0.5)
    width = yard.rows * _STACK_SPACING_M
    room = depth - 2 * _EDGE_M
    groups = max(1, int((room + _LANE_M) / (width + _LANE_M)))
    spacing = (room - width) / max(1, groups - 1)
    for k in range(groups):
        first = _EDGE_M + k * spacing
        _group(builder, frame.shift(_EDGE_M, first), yard, length - 2 * _EDGE_M)
        if k == groups - 1:
            continue
        lane_b = first + 0.5 * (width + spacing)
        builder.mark(frame.point([_EDGE_M, length - _EDGE_M], [lane_b, lane_b]), 0.15)
        for a in rng.uniform(8.0, length - 8.0, 2):
            _vehicle(builder, frame, float(a), lane_b)
    for a in (1.5, length - 1.5):
        for b in np.arange(2.0, depth, 12.0):
            small_object(builder, "bollard", frame.point(a, b), 0.0)


def _group(builder: PlaceBuilder, frame: StreetFrame, yard: Yard, length: float) -> None:
    """Place the rows between two lanes from the frame's origin, with a gap for a crane."""
    size = CONTAINER_M[yard.shape]
    step, group_width = size[0] + _GAP_M, yard.rows * _STACK_SPACING_M
    crane = (CRANE_M[0], group_width + 0.55 * _LANE_M, CRANE_M[2])
    gap_a = builder.rng.uniform(0.15, 0.85) * (length - crane[0])
    gap = frame.quad(gap_a, gap_a + crane[0], 0.0, group_width)
    builder.reserve(gap)
    position = (gap_a + 0.5 * crane[0], 0.5 * group_width)
    paint = builder.choose(_CRANE_PAINTS)
    gantry = ObjectSpec("crane", "gantry", crane, paint)
    builder.place(gantry, frame.point(*position), frame.yaw(*position), Footing(on_reserved=True))
    for b in (np.arange(yard.rows) + 0.5) * _STACK_SPACING_M:
        for a in np.arange(0.5 * step, length - 0.5 * step + 0.01, step):
            corners = frame.quad(a - 0.5 * size[0], a + 0.5 * size[0], b - 1.2, b + 1.2)
            builder.mark(np.vstack([corners, corners[:1]]), 0.10)
            if builder.chance(yard.occupied_share):
                _stack(builder, frame, (float(a), float(b)), yard)


def _stack(
    builder: PlaceBuilder, frame: StreetFrame, spot: tuple[float, float], yard: Yard
) -> None:
    """Place a stack of one to ``yard.max_stacked`` containers.

    The colour of the object is that of the top container.
    """
    rng = builder.rng
    count = int(rng.integers(1, yard.max_stacked + 1))
    length, width, height = CONTAINER_M[yard.shape]
    shape = yard.shape if count == 1 else f"{yard.shape}_{count}x{rng.integers(STACK_VARIANTS)}"
    size = (length, width, count * height)
    stack = ObjectSpec("container", shape, size, builder.choose(yard.colours))
    builder.place(stack, frame.point(*spot), frame.yaw(*spot) + builder.choose((0.0, np.pi)))


def _vehicle(builder: PlaceBuilder, frame: StreetFrame, a: float, b: float) -> None:
    """Place a reach stacker or a lorry in a lane."""
    yaw = frame.yaw(a, b) + builder.choose((0.0, np.pi))
    if builder.chance(0.4):
        stacker = ObjectSpec("truck", "stacker", STACKER_M, vary(builder, (0.45, 0.10, 0.02)))
        builder.place(stacker, frame.point(a, b), yaw)
    else:
        truck(builder, frame.point(a, b + builder.choose((-2.2, 2.2))), yaw, shapes=("lorry",))
