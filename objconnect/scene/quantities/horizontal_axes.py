"""The horizontal axes of coordinates: east and north, or the grid of a projected system.

Away from the central meridian of its zone, a grid is rotated against east and north by the
meridian convergence. GPS positions, which are along east and north, show which of the two it is.
"""

from __future__ import annotations

import math
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.geometry.geodesy import FARTHEST_M, Geodetic, longitude_difference
from objconnect.scene.quantities.reading import Reading, known, unknown

Axes = Literal["east and north", "grid"]

_ZONE_DEG: Final = 6.0
# One kind of axes is accepted if the other is at least this many times farther from the measured
# rotation,
_CLEARER: Final = 3.0
# and if the convergence exceeds this many standard deviations of the rotation; with few positions
# more are needed, as in Student's distribution.
_SIGMAS, _FEW = 3.0, 5.0


def utm_zone(longitude: float) -> int:
    """Return the UTM zone of a longitude (degrees), ignoring Norway's and Svalbard's exceptions."""
    return int((longitude + 180) % 360 // _ZONE_DEG) + 1


def convergence(place: Geodetic, zone: int) -> float:
    """Return the meridian convergence of a UTM grid at a place, radians.

    If it is positive, true north points to the left of the grid's north.
    """
    middle = zone * _ZONE_DEG - 180 - _ZONE_DEG / 2
    beside = math.radians(longitude_difference(place.longitude, middle))
    return math.atan(math.tan(beside) * math.sin(math.radians(place.latitude)))


def infer_axes(
    positions: NDArray[np.float64], measured: NDArray[np.float64], grid_turn: float
) -> Reading[Axes]:
    """Infer the horizontal axes of positions from GPS.

    Args:
        positions: (N, 2) metres along unknown axes, with any shift.
        measured: (N, 2) metres east and north; NaN where not measured.
        grid_turn: rotation of the grid against east and north, radians (``convergence``).

    Returns:
        The axes; unknown if the positions fit both or neither.
    """
    source = "gps_position"
    there = (np.abs(measured) <= FARTHEST_M).all(1)
    if there.sum() < 3:
        return unknown(source, f"{source} is known for {there.sum()} photographs")
    own, gps = positions[there], measured[there]
    own, gps = own - own.mean(0), gps - gps.mean(0)
    spread = float(np.linalg.norm(gps))
    if not spread > 1e-6:
        return unknown(source, f"{source} is the same for all photographs")
    across = float((gps[:, 0] * own[:, 1] - gps[:, 1] * own[:, 0]).sum())
    turn = math.atan2(across, float((gps * own).sum()))
    cos, sin = math.cos(turn), math.sin(turn)
    off = own - gps @ np.array([[cos, sin], [-sin, cos]])
    free = 2 * len(own) - 4
    sigma = float(np.sqrt((off**2).sum() / free)) / spread
    from_east, from_grid = abs(turn), abs(turn - grid_turn)
    rotation = f"turned by {math.degrees(turn):.2f} degrees against {source}"
    if _SIGMAS * (1 + _FEW / free) * sigma > abs(grid_turn):
        return unknown(source, f"{source} scatters too much to determine the axes")
    if from_grid > _CLEARER * from_east:
        return known("east and north", source)
    if from_east > _CLEARER * from_grid:
        return known("grid", source, rotation)
    return unknown(source, rotation)
