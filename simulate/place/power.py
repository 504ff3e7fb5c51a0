"""Place power lines: poles along a road, with wires between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.geometry.rectangle import rectangle
from simulate.place.builder import Footing, PlaceBuilder
from simulate.place.objects import small_object
from simulate.place.roadside import is_off_junction
from simulate.place.world import Heightfield, polyline_length, polyline_points

Array = NDArray[np.float64]

_POLE_SPACING_M = 42.0  # distance between poles
_WIRE_HEIGHT_M = 8.75  # height of the wires above the ground at a pole
WIRE_SPACING_M = 1.7  # distance between the two wires
WIRE_RADIUS_M = 0.03
_SAG = 0.02  # sag of a wire, as a share of its span


def power_lines(builder: PlaceBuilder) -> None:
    """Place power lines along roads.

    The roads that cross the place are sorted by their distance from its centre, and every third of
    them has a power line.
    """
    crossing = [r for r in builder.roads if polyline_length(r.line) > builder.side_m]
    crossing.sort(key=lambda r: float(np.linalg.norm(r.line, axis=1).min()))
    for road in crossing[::3]:
        side = builder.choose((1.0, -1.0))
        last: Array | None = None
        for s in np.arange(0.0, polyline_length(road.line), _POLE_SPACING_M):
            pole = _pole(builder, road.line, s, side * (0.5 * road.width_m + 1.4))
            if pole is not None and last is not None:
                _wires(builder, np.stack([last, pole]))
            last = pole


def _pole(builder: PlaceBuilder, line: Array, s: float, offset: float) -> Array | None:
    """Place a pole beside a line (K, 2), at ``s`` metres or up to 12 m farther.

    Return its position (2,), or None without room.
    """
    for ahead_m in np.arange(0.0, 15.0, 3.0):
        (p,), (along,) = polyline_points(line, s + ahead_m)
        position = p + offset * np.array([-along[1], along[0]])
        yaw = float(np.arctan2(along[1], along[0]))
        if is_off_junction(builder, position, 1.2) and small_object(
            builder, "pole", position, yaw, Footing(on_road=True)
        ):
            return np.asarray(position)
    return None


def _wires(builder: PlaceBuilder, ends: Array) -> None:
    """Hang the wires between two poles (2, 2), and keep the ground below free of trees."""
    length = float(np.linalg.norm(ends[1] - ends[0]))
    z = wire_heights(builder.terrain, ends)
    builder.hang(
        "wire", ends, (z[0], z[-1]), WIRE_SPACING_M + 2 * WIRE_RADIUS_M, z.min() - 2 * WIRE_RADIUS_M
    )
    yaw = float(np.arctan2(*(ends[1] - ends[0])[::-1]))
    builder.reserve(rectangle(ends.mean(0), (length, WIRE_SPACING_M + 0.6), yaw))


def wire_heights(terrain: Heightfield, ends: Array) -> Array:
    """Return the heights (9,) in metres of a wire between two poles (2, 2), which is a parabola."""
    a, b = terrain.height(ends[:, 0], ends[:, 1]) + _WIRE_HEIGHT_M
    t = np.linspace(0, 1, 9)
    sag = _SAG * float(np.linalg.norm(ends[1] - ends[0]))
    return np.asarray(a + t * (b - a) - 4 * sag * t * (1 - t))
