"""Plan corridors, free flights and drives along streets.

The functions return planned exposures, ``simulate.flight.gimbal.Aims``. Wind is not included.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from simulate.flight.config import CorridorFlight, FreeFlight, StreetFlight
from simulate.flight.context import MAX_PHOTOGRAPHS, FlightContext
from simulate.flight.flights import INSET_SHARE
from simulate.flight.gimbal import Aims
from simulate.place.world import Road, polyline_length, polyline_points

Array = NDArray[np.float64]

_SHARPEST_TURN_DEG = 150
# Distance (m) between possible stops of a vehicle.
_STREET_STEP_M = 1.0
# Distance (m) between points of a road that is clipped to the place.
_ROAD_STEP_M = 5.0
# Default minimum and maximum altitude of a free flight, as shares of a survey's altitude.
_FREE_ALTITUDES = 0.7, 1.1
# Ranges of the number of periods of a free flight's waves; slower waves are stronger.
_PERIODS = np.array([[0.6, 1.2], [1.2, 2.5], [2.5, 4.0]])


def offset_line(line: Array, arc_m: Array, right_m: Array | float) -> tuple[Array, Array]:
    """Return points and directions of travel at an offset from a polyline.

    Directions turn smoothly between corners, so that parallel lines neither cross nor separate. No
    point is farther than ``right_m`` from the line.

    Args:
        line: Points (K, 2) of the line, metres.
        arc_m: Arc lengths (N,) on the line, metres.
        right_m: Offset to the right of the direction of travel, metres, (N,) or one for all.

    Returns:
        Points (N, 2) in metres and directions (N,) in radians clockwise from north.

    Raises:
        InputError: The line has no length, or turns back on itself.
    """
    steps = np.diff(line, axis=0)
    length = np.linalg.norm(steps, axis=1)
    line, steps, length = line[np.append(True, length > 0)], steps[length > 0], length[length > 0]
    if not len(steps):
        raise InputError("a route needs two different points")
    unit = steps / length[:, None]
    turn = np.degrees(np.arccos(np.clip((unit[1:] * unit[:-1]).sum(1), -1, 1)))
    if turn.max(initial=0) > _SHARPEST_TURN_DEG:
        x, y = line[1 + int(turn.argmax())]
        raise InputError(
            f"a route turns by more than {_SHARPEST_TURN_DEG} degrees at ({x:g}, {y:g}) m: make "
            "the corner flatter"
        )
    tangent = np.vstack([unit[:1], unit[1:] + unit[:-1], unit[-1:]])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    start = np.concatenate([[0.0], np.cumsum(length)])
    point, ahead = (
        np.column_stack([np.interp(arc_m, start, values[:, k]) for k in (0, 1)])
        for values in (line, tangent)
    )
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    right = np.column_stack([ahead[:, 1], -ahead[:, 0]])
    offset = np.broadcast_to(right_m, len(point))
    return point + offset[:, None] * right, np.arctan2(ahead[:, 0], ahead[:, 1])


def corridor_aims(flight: CorridorFlight, context: FlightContext, frames: int | None) -> Aims:
    """Plan parallel lines along a polyline; every second one is flown back.

    Args:
        flight: The corridor. Its altitude is above the ground below each exposure, or above the
            ground at the line's start without ``terrain_following``.
        context: The place and the camera.
        frames: The exact number of exposures, evenly spaced. None takes the number that the overlap
            needs along the polyline.

    Returns:
        The exposures (N) in flying order.

    Raises:
        InputError: The line has no length or turns back on itself, the place has no road to
            follow, or there are too many photographs.
    """
    line = _longest_road(context) if flight.line is None else np.array(flight.line)
    if context.defaults.backwards:
        line = line[::-1]
    altitude_m = flight.altitude(context.camera.focal[0], context.defaults.nadir_altitude_m)
    length = polyline_length(line)
    exposures = _corridor_exposures(flight, context.footprint_m(altitude_m), length, frames)
    share = np.where(exposures.back, 1 - exposures.share, exposures.share)
    xy, heading = offset_line(line, share * length, exposures.right_m)
    below = xy if flight.terrain_following else np.broadcast_to(line[0], xy.shape)
    z = context.ground_height(below[:, 0], below[:, 1]) + altitude_m
    return Aims(
        np.column_stack([xy, z]),
        np.where(exposures.back, heading + np.pi, heading),
        np.full(len(xy), np.radians(flight.pitch_deg)),
    )


class _Exposures(NamedTuple):
    """The exposures of a corridor, relative to its polyline.

    Attributes:
        right_m: Offset (N,) to the right of the polyline, metres.
        share: Share (N,) of the corridor's length, counted in the direction of flight.
        back: Whether each exposure (N,) is on a line that is flown back.
    """

    right_m: Array
    share: Array
    back: NDArray[np.bool_]


def _corridor_exposures(
    flight: CorridorFlight, footprint_m: tuple[float, float], length: float, frames: int | None
) -> _Exposures:
    """Return the exposures of a corridor of ``length`` metres."""
    forward_overlap, side_overlap = flight.overlaps
    across_m = (1 - side_overlap) * footprint_m[0]
    along_m = (1 - forward_overlap) * footprint_m[1]
    # Outer lines lie inside the strip by less than half a footprint, as in a survey.
    reach = max(0.5 * flight.width_m - INSET_SHARE * min(footprint_m), 0.0)
    if max(2 * reach / across_m, length / along_m, frames or 0) > MAX_PHOTOGRAPHS:
        raise InputError(
            f"the flight needs more than {MAX_PHOTOGRAPHS} photographs: overlap less or fly higher"
        )
    lines = int(np.ceil(2 * reach / across_m)) + 1 if flight.lines is None else flight.lines
    if frames is None:
        count = int(np.ceil(length / along_m)) + 1
        share = np.tile(np.linspace(0, 1, count), lines)
        number = np.repeat(np.arange(lines), count)
    else:
        # Equal steps along all lines joined end to end.
        at = (np.arange(frames) + 0.5) / frames * lines
        number = np.floor(at).astype(int)
        share = at - number
    right_m = np.linspace(-reach, reach, lines) if lines > 1 else np.zeros(1)
    return _Exposures(right_m[number], share, number % 2 == 1)


def street_aims(flight: StreetFlight, context: FlightContext, frames: int) -> Aims:
    """Plan the drive of a vehicle on the right-hand lane of the roads of a place.

    All of the vehicle's cameras expose together at each stop, as in a survey of streets (the
    cameras of CMU Seasons looked 45 degrees to both sides).

    Args:
        flight: The drive.
        context: The place with its roads.
        frames: The number of photographs of all cameras together. Stops are spread evenly over all
            roads.

    Returns:
        The exposures (``frames``) in driving order.

    Raises:
        InputError: The roads have fewer free positions than the drive needs.
    """
    cameras = len(flight.yaws_deg)
    stops = -(-frames // cameras)
    candidates = [np.empty((0, 4))]
    for line, width_m in _driven_roads(flight, context):
        right_m = 0.25 * width_m + flight.offset_m
        arc_m = np.arange(0.0, polyline_length(line), _STREET_STEP_M)
        xy, heading = offset_line(line, arc_m, right_m)
        z = context.ground_height(xy[:, 0], xy[:, 1]) + flight.height_m
        candidates.append(np.column_stack([xy, z, heading]))
    positions = np.concatenate(candidates)
    reach = max(0.5 * context.side_m - flight.edge_m, 0.0)
    away_from_edge = (np.abs(positions[:, :2]) <= reach).all(1)
    positions = positions[away_from_edge & context.is_free(positions[:, :3])]
    if len(positions) < stops:
        raise InputError(
            f"the roads have {len(positions)} free positions, {stops} are needed: choose fewer "
            "frames or a larger area"
        )
    chosen = positions[((np.arange(stops) + 0.5) / stops * len(positions)).astype(int)]
    yaw = chosen[:, 3:] + np.radians(flight.yaws_deg)
    centres = np.repeat(chosen[:, :3], cameras, axis=0)[:frames]
    return Aims(centres, yaw.ravel()[:frames], np.full(frames, np.radians(flight.pitch_deg)))


def free_aims(
    flight: FreeFlight, context: FlightContext, frames: int, rng: np.random.Generator
) -> Aims:
    """Plan a smooth random path over the square area of a place.

    The cameras look towards a point that moves around the middle of the place. The altitude above
    the ground and the pitch vary within the ranges of the flight.

    Args:
        flight: The ranges of altitude and pitch.
        context: The place.
        frames: The number of exposures.
        rng: The generator of the path.

    Returns:
        The exposures (``frames``) in flying order.
    """
    default_m = context.defaults.nadir_altitude_m
    lowest, highest = _FREE_ALTITUDES

    def draw_curve(low: float, high: float) -> Array:
        """Return a smooth random function of time, (frames,) values from ``low`` to ``high``."""
        periods = rng.uniform(*_PERIODS.T)
        phase = rng.uniform(0, 2 * np.pi, len(periods))
        weight = 1 / np.arange(1, len(periods) + 1)
        wave = np.sin(2 * np.pi * np.outer(time, periods) + phase) @ (weight / weight.sum())
        return np.asarray(low + 0.5 * (high - low) * (1 + wave))

    time = (np.arange(frames) + 0.5) / frames
    reach, aim_reach = 0.45 * context.side_m, 0.15 * context.side_m
    x, y = draw_curve(-reach, reach), draw_curve(-reach, reach)
    east, north = draw_curve(-aim_reach, aim_reach) - x, draw_curve(-aim_reach, aim_reach) - y
    altitude_m = flight.altitude_m or (lowest * default_m, highest * default_m)
    z = context.ground_height(x, y) + draw_curve(*altitude_m)
    pitch = np.radians(draw_curve(*flight.pitch_deg))
    return Aims(np.column_stack([x, y, z]), np.arctan2(east, north), pitch)


def _driven_roads(flight: StreetFlight, context: FlightContext) -> list[tuple[Array, float]]:
    """Return the centre lines (K, 2) in driving direction, and the widths of the roads."""
    roads: Sequence[Road] = context.roads
    if flight.roads is not None:
        by_length = sorted(roads, key=lambda road: -len(_part_inside(road, context.side_m)))
        roads = by_length[: flight.roads]
    direction = flight.way or ("back" if context.defaults.backwards else "there")
    steps = {"there": (1,), "back": (-1,), "both": (1, -1)}[direction]
    return [(road.line[::step], road.width_m) for road in roads for step in steps]


def _longest_road(context: FlightContext) -> Array:
    """Return the line (K, 2) of the road that is longest inside the place, clipped to it."""
    parts = (_part_inside(road, context.side_m) for road in context.roads)
    longest = max(parts, key=len, default=np.empty((0, 2)))
    if len(longest) < 2:
        raise InputError("this place has no road for a corridor to follow: give the flight a line")
    return longest


def _part_inside(road: Road, side_m: float) -> Array:
    """Return equidistant points (N, 2) of a road, from the first to the last inside the place."""
    points, _ = polyline_points(road.line, np.arange(0.0, polyline_length(road.line), _ROAD_STEP_M))
    inside = np.flatnonzero((np.abs(points) <= 0.5 * side_m).all(1))
    return points[inside[0] : inside[-1] + 1] if len(inside) else points[:0]
