"""Place power lines: poles along a road, with wires between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.geometry.rectangle import rectangle
from simulate.place.objects import small
from simulate.place.roadside import off_junction
from simulate.place.site import Footing, Site
from simulate.place.world import Heightfield, polyline_length, polyline_points

Array = NDArray[np.float64]

_PITCH_M = 42.0  # distance between poles
_ATTACHED_M = 8.75  # height of the wires above the ground at a pole
WIRE_SPACING_M = 1.7  # distance between the two wires
WIRE_RADIUS_M = 0.03
_SAG = 0.02  # as a share of the span


def power_lines(site: Site) -> None:
    """Place power lines along roads.

    Sort the roads that cross the site by distance from its centre, and place a power line along
    every third.
    """
    crossing = [r for r in site.roads if polyline_length(r.line) > site.area_m]
    crossing.sort(key=lambda r: float(np.linalg.norm(r.line, axis=1).min()))
    for road in crossing[::3]:
        side = site.choose((1.0, -1.0))
        last: Array | None = None
        for s in np.arange(0.0, polyline_length(road.line), _PITCH_M):
            pole = _pole(site, road.line, s, side * (0.5 * road.width_m + 1.4))
            if pole is not None and last is not None:
                _wires(site, np.stack([last, pole]))
            last = pole


def _pole(site: Site, line: Array, s: float, offset: float) -> Array | None:
    """Place a pole beside a line (K, 2), at ``s`` metres or up to 12 m farther; return where."""
    for on in np.arange(0.0, 15.0, 3.0):
        (p,), (along,) = polyline_points(line, s + on)
        at = p + offset * np.array([-along[1], along[0]])
        yaw = float(np.arctan2(along[1], along[0]))
        if off_junction(site, at, 1.2) and small(site, "pole", at, yaw, Footing(on_road=True)):
            return np.asarray(at)
    return None


def _wires(site: Site, ends: Array) -> None:
    """Hang the wires between two poles (2, 2), and keep the ground below free of trees."""
    length = float(np.linalg.norm(ends[1] - ends[0]))
    z = wire_heights(site.terrain, ends)
    site.span(
        "wire", ends, (z[0], z[-1]), WIRE_SPACING_M + 2 * WIRE_RADIUS_M, z.min() - 2 * WIRE_RADIUS_M
    )
    yaw = float(np.arctan2(*(ends[1] - ends[0])[::-1]))
    site.reserve(rectangle(ends.mean(0), (length, WIRE_SPACING_M + 0.6), yaw))


def wire_heights(terrain: Heightfield, ends: Array) -> Array:
    """Return the heights (9,) in metres of a wire between two poles (2, 2), which is a parabola."""
    a, b = terrain.height(ends[:, 0], ends[:, 1]) + _ATTACHED_M
    t = np.linspace(0, 1, 9)
    sag = _SAG * float(np.linalg.norm(ends[1] - ends[0]))
    return np.asarray(a + t * (b - a) - 4 * sag * t * (1 - t))
