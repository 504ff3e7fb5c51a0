"""The horizontal axes of coordinates: east and north, or the grid of a projected system.

Away from the central meridian of its zone, a grid is rotated against east and north by the
meridian convergence. GPS positions, which are along east and north, show which axes are used.
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
# One kind of axes is accepted if the other is more than this many times farther from the measured
# rotation.
_MIN_DISTANCE_RATIO: Final = 3.0
# The convergence must also exceed ``_SIGMAS`` standard deviations of the rotation. With few
# positions it must exceed more (``_FEW_POSITIONS``), as in Student's distribution.
_SIGMAS, _FEW_POSITIONS = 3.0, 5.0


def utm_zone(longitude: float) -> int:
    """Return the UTM zone of a longitude (degrees), ignoring Norway's and Svalbard's exceptions."""
    return int((longitude + 180) % 360 // _ZONE_DEG) + 1


def convergence(place: Geodetic, zone: int) -> float:
    """Return the meridian convergence of a UTM grid at a place, radians.

    If it is positive, true north points to the left of the grid's north.
    """
    meridian = zone * _ZONE_DEG - 180 - _ZONE_DEG / 2
    from_meridian = math.radians(longitude_difference(place.longitude, meridian))
    return math.atan(math.tan(from_meridian) * math.sin(math.radians(place.latitude)))


def infer_axes(
    positions: NDArray[np.float64], gps_positions: NDArray[np.float64], grid_turn: float
) -> Reading[Axes]:
    """Infer the horizontal axes of positions from GPS.

    Args:
        positions: (N, 2) metres along unknown axes, with any shift.
        gps_positions: (N, 2) metres east and north; NaN where not measured.
        grid_turn: rotation of the grid against east and north, radians (``convergence``).

    Returns:
        The axes; unknown if the positions fit both or neither.
    """
    source = "gps_position"
    is_measured = (np.abs(gps_positions) <= FARTHEST_M).all(1)
    if is_measured.sum() < 3:
        return unknown(
            source, f"{source} is known for {is_measured.sum()} photographs, and 3 are needed"
        )
    centred, gps = positions[is_measured], gps_positions[is_measured]
    centred, gps = centred - centred.mean(0), gps - gps.mean(0)
    spread = float(np.linalg.norm(gps))
    if not spread > 1e-6:
        return unknown(source, f"{source} is the same for all photographs")
    cross = float((gps[:, 0] * centred[:, 1] - gps[:, 1] * centred[:, 0]).sum())
    turn = math.atan2(cross, float((gps * centred).sum()))
    cos, sin = math.cos(turn), math.sin(turn)
    residual = centred - gps @ np.array([[cos, sin], [-sin, cos]])
    degrees_of_freedom = 2 * len(centred) - 4
    sigma = float(np.sqrt((residual**2).sum() / degrees_of_freedom)) / spread
    from_east, from_grid = abs(turn), abs(turn - grid_turn)
    rotation = f"turned by {math.degrees(turn):.2f} degrees against {source}"
    if _SIGMAS * (1 + _FEW_POSITIONS / degrees_of_freedom) * sigma > abs(grid_turn):
        return unknown(source, f"{source} scatters too much to determine the axes")
    if from_grid > _MIN_DISTANCE_RATIO * from_east:
        return known("east and north", source)
    if from_east > _MIN_DISTANCE_RATIO * from_grid:
        return known("grid", source, rotation)
    return unknown(source, rotation)
