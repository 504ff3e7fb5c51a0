"""Place single objects, with their sizes and colours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulate.place.builder import OPEN_GROUND, Footing, ObjectSpec, PlaceBuilder
from simulate.place.streets import StreetFrame
from simulate.place.styles import vary
from simulate.place.world import BuildingStyle, Rgb

Array = NDArray[np.float64]
Size = tuple[float, float, float]  # length, width, height in metres
Local = tuple[float, float]  # metres along and across the street of a frame

# Linear albedo of vehicles.
_PAINTS: tuple[Rgb, ...] = (
    (0.62, 0.62, 0.61),
    (0.30, 0.31, 0.32),
    (0.020, 0.021, 0.023),
    (0.075, 0.078, 0.085),
    (0.30, 0.022, 0.018),
    (0.025, 0.06, 0.19),
    (0.05, 0.09, 0.06),
    (0.38, 0.34, 0.27),
)
# Linear albedo of containers and lorries.
STEEL_COLOURS: tuple[Rgb, ...] = (
    (0.28, 0.050, 0.028),
    (0.035, 0.09, 0.22),
    (0.05, 0.15, 0.07),
    (0.42, 0.21, 0.04),
    (0.40, 0.40, 0.39),
    (0.17, 0.04, 0.03),
)
# Length, width, height in metres.
_CARS: dict[str, Size] = {
    "hatchback": (4.0, 1.76, 1.48),
    "saloon": (4.6, 1.82, 1.44),
    "estate": (4.7, 1.83, 1.50),
    "suv": (4.6, 1.90, 1.70),
}
_TRUCKS: dict[str, Size] = {
    "van": (5.6, 2.0, 2.45),
    "lorry": (8.4, 2.45, 3.4),
}
_BENCH_M: Size = (1.8, 0.65, 0.85)
LAMP_M: Size = (1.7, 0.24, 7.0)
CONTAINER_M: dict[str, Size] = {
    "container": (6.06, 2.44, 2.59),
    "long_container": (12.19, 2.44, 2.59),
}
CRANE_M: Size = (10.0, 24.0, 17.0)
STACKER_M: Size = (11.0, 4.2, 5.0)
_GREY: Rgb = (0.20, 0.205, 0.21)
_CREOSOTE: Rgb = (0.12, 0.085, 0.06)
# Size of each small object, and the colours of its painted parts.
_SMALL_OBJECTS: dict[str, tuple[Size, tuple[Rgb, ...]]] = {
    "bin": ((0.60, 0.60, 1.05), ((0.03, 0.10, 0.05), _GREY, (0.035, 0.04, 0.05))),
    "hydrant": ((0.40, 0.48, 0.85), ((0.45, 0.03, 0.02), (0.50, 0.36, 0.03))),
    "sign": ((0.13, 0.80, 2.68), ((0.48, 0.03, 0.02), (0.02, 0.09, 0.40), (0.55, 0.42, 0.02))),
    "bollard": ((0.24, 0.24, 1.05), (_GREY, (0.50, 0.38, 0.03))),
    "table": ((1.90, 1.70, 0.76), ((0.24, 0.15, 0.085),)),
    "bale": ((1.50, 1.24, 1.50), ((1.0, 1.0, 1.0),)),
    "tractor": ((4.00, 2.22, 2.62), ((0.05, 0.17, 0.03), (0.40, 0.03, 0.02), (0.03, 0.10, 0.32))),
    "pole": ((0.34, 2.00, 9.00), (_CREOSOTE,)),
    "tank": ((6.00, 6.00, 10.0), ((0.50, 0.50, 0.49), (0.42, 0.44, 0.46), (0.35, 0.38, 0.33))),
    "pallet": ((1.20, 0.80, 1.16), ((0.35, 0.26, 0.16), (0.30, 0.31, 0.32), (0.08, 0.16, 0.30))),
    "cabinet": ((2.40, 1.30, 2.20), ((0.42, 0.43, 0.42), (0.16, 0.22, 0.15))),
    "boat": ((4.20, 1.50, 0.66), ((0.55, 0.55, 0.53), (0.30, 0.04, 0.03), (0.03, 0.12, 0.25))),
}


def small_object(
    builder: PlaceBuilder,
    kind: str,
    position: Array,
    yaw: float,
    footing: Footing = OPEN_GROUND,
) -> bool:
    """Place a small object whose class is also its shape, such as a bin, a hydrant or a boat."""
    size, colours = _SMALL_OBJECTS[kind]
    colour = vary(builder, builder.choose(colours))
    return builder.place(ObjectSpec(kind, kind, size, colour), position, yaw, footing)


def steel_colour(builder: PlaceBuilder) -> Rgb:
    """Draw the colour of a container."""
    return vary(builder, builder.choose(STEEL_COLOURS))


def building(
    builder: PlaceBuilder,
    shape: str,
    frame: StreetFrame,
    spot: Local,
    size: Size,
    style: BuildingStyle,
) -> bool:
    """Place a building that faces its street, reduced in size where there is less room.

    Return whether it was placed.
    """
    position, yaw = frame.point(*spot), frame.yaw(*spot)
    for scale in (1.0, 0.9, 0.8, 0.7):
        fitted = (size[0] * scale, size[1] * scale, size[2])
        if builder.place(ObjectSpec("building", shape, fitted, style=style), position, yaw):
            return True
    return False


def tree_spec(builder: PlaceBuilder, radius: float, conifers: float) -> ObjectSpec:
    """Draw a tree with a crown of ``radius`` metres.

    With probability ``conifers`` it is a conifer, whose crown has three quarters of that radius.
    """
    rng = builder.rng
    value, warm = rng.uniform(0.75, 1.3), rng.uniform(0.88, 1.18)
    colour = (value * warm, value, value)
    if builder.chance(conifers):
        size = (1.5 * radius, 1.5 * radius, radius * rng.uniform(3.0, 4.2) + 1.0)
        shape = f"conifer_{rng.integers(3)}"
    else:
        size = (2 * radius, 2 * radius, radius * rng.uniform(2.1, 2.9) + 1.2)
        shape = f"broadleaf_{rng.integers(6)}"
    return ObjectSpec("tree", shape, size, colour)


def tree(builder: PlaceBuilder, position: Array, radius: float, conifers: float = 0.12) -> bool:
    """Place a tree as ``tree_spec`` draws it."""
    spec = tree_spec(builder, radius, conifers)
    return builder.place(spec, position, builder.rng.uniform(-np.pi, np.pi))


def bench(builder: PlaceBuilder, position: Array, yaw: float) -> bool:
    spec = ObjectSpec("bench", "bench", _BENCH_M, (0.20, 0.12, 0.07))
    return builder.place(spec, position, yaw, Footing(gap_m=0.05))


def barrier(
    builder: PlaceBuilder,
    kind: str,
    frame: StreetFrame,
    start: Local,
    end: Local,
    section: tuple[float, float],
) -> None:
    """Place a straight hedge or fence between two local points, 0.15 m shorter at each end.

    ``section`` is its thickness and height, metres.
    """
    p, q = frame.point(*start), frame.point(*end)
    length = float(np.linalg.norm(q - p)) - 0.3
    if length < 1.0:
        return
    yaw = float(np.arctan2(*(q - p)[::-1]))
    colour = vary(builder, (1.0, 1.0, 1.0) if kind == "hedge" else (0.22, 0.16, 0.11))
    spec = ObjectSpec(kind, kind, (length, *section), colour)
    builder.place(spec, 0.5 * (p + q), yaw, Footing(gap_m=0.02))


def place_fences(
    builder: PlaceBuilder, frame: StreetFrame, length: float, depth: float, height: float
) -> None:
    """Place fences along both sides and the back of a block, in pieces that follow its bends."""
    for b in np.arange(0.8, depth - 13.0, 12.0):
        for a in (0.3, length - 0.3):
            barrier(builder, "fence", frame, (a, b), (a, b + 12.0), (0.10, height))
    for a in np.arange(0.8, length - 13.0, 12.0):
        barrier(builder, "fence", frame, (a, depth - 0.4), (a + 12.0, depth - 0.4), (0.10, height))


def car(
    builder: PlaceBuilder, position: Array, yaw: float, gap_m: float = 0.15, *, driven: bool = False
) -> bool:
    shape = builder.choose(tuple(_CARS))
    paint = vary(builder, builder.choose(_PAINTS))
    spec = ObjectSpec("car", shape, _CARS[shape], paint, driven=driven, leans=True)
    return builder.place(spec, position, yaw, Footing(on_road=True, on_reserved=True, gap_m=gap_m))


def van(builder: PlaceBuilder, position: Array, yaw: float) -> bool:
    paint = vary(builder, builder.choose(_PAINTS[:4]))
    spec = ObjectSpec("van", "van", _TRUCKS["van"], paint, leans=True)
    return builder.place(spec, position, yaw, Footing(on_road=True, on_reserved=True))


def truck(
    builder: PlaceBuilder,
    position: Array,
    yaw: float,
    *,
    shapes: Sequence[str] = tuple(_TRUCKS),
    on_road: bool = False,
    driven: bool = False,
) -> bool:
    shape = builder.choose(shapes)
    paint = vary(builder, builder.choose(_PAINTS[:2] + STEEL_COLOURS))
    class_name = "van" if shape == "van" else "truck"
    spec = ObjectSpec(class_name, shape, _TRUCKS[shape], paint, driven=driven, leans=True)
    return builder.place(spec, position, yaw, Footing(on_road=on_road, on_reserved=on_road))
