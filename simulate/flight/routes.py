"""Flights along a line: corridors from the air, streets from a vehicle; and free flight.

Aims as in `simulate.flight.gimbal`; the wind comes later.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from scene.errors import InputError
from simulate.flight.flights import MAX_PHOTOGRAPHS, GroundHeight
from simulate.flight.gimbal import Aims

Array = NDArray[np.float64]

_SHARPEST_TURN_DEG = 150
# Candidate positions of a vehicle, metres apart.
_STREET_STEP_M = 1.0
# Of a free flight's course: periods per flight, the slower the stronger.
_PERIODS = np.array([[0.6, 1.2], [1.2, 2.5], [2.5, 4.0]])


def beside(line: Array, at_m: Array, right_m: Array | float) -> tuple[Array, Array]:
    """Points (N, 2) and directions (N,) of travel `right_m` beside a (K, 2) line.

    Directions turn smoothly between the line's corners, so that parallel lines neither cross nor
    tear; no point is farther than `right_m` from the line.

    Args:
        at_m: arc lengths (N,) metres.
        right_m: distance to the right of the direction of travel, metres, (N,) or one for all.

    Returns:
        Points in metres and directions in radians clockwise from north.

    Raises:
        InputError: the line has no length, or turns back on itself.
    """
    steps = np.diff(line, axis=0)
    length = np.linalg.norm(steps, axis=1)
    line, steps, length = line[np.append(True, length > 0)], steps[length > 0], length[length > 0]
    if not len(steps):
        raise InputError("a route needs two points that differ")
    unit = steps / length[:, None]
    turn = np.degrees(np.arccos(np.clip((unit[1:] * unit[:-1]).sum(1), -1, 1)))
    if turn.max(initial=0) > _SHARPEST_TURN_DEG:
        x, y = line[1 + int(turn.argmax())]
        raise InputError(
            f"a route turns back on itself at ({x:g}, {y:g}) m: leave {180 - _SHARPEST_TURN_DEG} "
            "degrees between its legs"
        )
    tangent = np.vstack([unit[:1], unit[1:] + unit[:-1], unit[-1:]])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    start = np.concatenate([[0.0], np.cumsum(length)])
    point, ahead = (
        np.column_stack([np.interp(at_m, start, values[:, k]) for k in (0, 1)])
        for values in (line, tangent)
    )
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    right = np.column_stack([ahead[:, 1], -ahead[:, 0]])
    offset = np.broadcast_to(right_m, len(point))
    return point + offset[:, None] * right, np.arctan2(ahead[:, 0], ahead[:, 1])


def plan_corridor(
    line: Array,
    ground_height: GroundHeight,
    *,
    footprint_m: tuple[float, float],
    altitude_m: float,
    width_m: float,
    lines: int | None,
    frames: int | None,
    forward_overlap: float,
    side_overlap: float,
    pitch_deg: float,
    terrain_following: bool,
) -> Aims:
    """Parallel lines along a (K, 2) line in metres, every second one flown back.

    Args:
        footprint_m: of a photograph on flat ground straight below, across and along, metres.
        altitude_m: above the ground below each exposure, or above that at the line's start.
        width_m: of the strip to photograph; no camera leaves it.
        lines: side by side; None: as many as the side overlap needs.
        frames: exactly so many exposures, evenly spaced; None: as many as the overlap needs along
            the line itself.

    Raises:
        InputError: the line has no length or turns back on itself, or too many photographs.
    """
    across_m = (1 - side_overlap) * footprint_m[0]
    along_m = (1 - forward_overlap) * footprint_m[1]
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    # Outer lines lie inside the strip by somewhat less than half a footprint, as in a survey.
    reach = max(0.5 * width_m - 0.3 * min(footprint_m), 0.0)
    if max(2 * reach / across_m, length / along_m, frames or 0) > MAX_PHOTOGRAPHS:
        raise InputError(
            f"a flight takes at most {MAX_PHOTOGRAPHS} photographs: overlap less or fly higher"
        )
    if lines is None:
        lines = int(np.ceil(2 * reach / across_m)) + 1
    if frames is None:
        count = int(np.ceil(length / along_m)) + 1
        along = np.tile(np.linspace(0, 1, count), lines)
        which = np.repeat(np.arange(lines), count)
    else:
        at = (np.arange(frames) + 0.5) / frames * lines  # all lines end to end in equal steps
        which = np.floor(at).astype(int)
        along = at - which
    offsets = np.linspace(-reach, reach, lines) if lines > 1 else np.zeros(1)
    back = which % 2 == 1
    xy, heading = beside(line, np.where(back, 1 - along, along) * length, offsets[which])
    below = xy if terrain_following else np.broadcast_to(line[0], xy.shape)
    z = ground_height(below[:, 0], below[:, 1]) + altitude_m
    return Aims(
        np.column_stack([xy, z]),
        np.where(back, heading + np.pi, heading),
        np.full(len(xy), np.radians(pitch_deg)),
    )


def plan_street(
    roads: Sequence[tuple[Array, float]],
    ground_height: GroundHeight,
    free: Callable[[Array], NDArray[np.bool_]],
    *,
    height_m: float,
    yaws_deg: tuple[float, ...],
    pitch_deg: float,
    frames: int,
    offset_m: float = 0.0,
) -> Aims:
    """A vehicle on the right-hand lane of every road, with a camera for each of `yaws_deg`.

    All cameras expose together, one stop after the other, as in a survey of streets (CMU Seasons'
    car looked 45 degrees to both sides).

    Args:
        roads: centre lines (K, 2) in metres, driven from their start, and widths in metres.
        free: which of (N, 3) positions the camera can be at.
        height_m: of the camera above the ground.
        yaws_deg: of the cameras, clockwise from the direction of travel.
        frames: photographs of all cameras together; stops are spread evenly over all roads.
        offset_m: to the right of the middle of the lane.

    Raises:
        InputError: the roads have fewer free places than the flight needs.
    """
    stops = -(-frames // len(yaws_deg))
    found = [np.empty((0, 4))]
    for line, width_m in roads:
        length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
        right_m = 0.25 * width_m + offset_m
        xy, heading = beside(line, np.arange(0.0, length, _STREET_STEP_M), right_m)
        z = ground_height(xy[:, 0], xy[:, 1]) + height_m
        found.append(np.column_stack([xy, z, heading]))
    places = np.concatenate(found)
    places = places[free(places[:, :3])]
    if len(places) < stops:
        raise InputError(
            f"the roads have {len(places)} free places, {stops} are needed: fewer frames, or "
            "another place"
        )
    chosen = places[((np.arange(stops) + 0.5) / stops * len(places)).astype(int)]
    yaw = chosen[:, 3:] + np.radians(yaws_deg)
    centres = np.repeat(chosen[:, :3], len(yaws_deg), axis=0)[:frames]
    return Aims(centres, yaw.ravel()[:frames], np.full(frames, np.radians(pitch_deg)))


def plan_free(
    area_m: float,
    ground_height: GroundHeight,
    *,
    altitude_m: tuple[float, float],
    pitch_deg: tuple[float, float],
    frames: int,
    rng: np.random.Generator,
) -> Aims:
    """A smooth random course over a square of `area_m` metres.

    The camera looks towards a point that wanders about the middle; altitude above the ground and
    pitch wander within their ranges.
    """

    def course(low: float, high: float) -> Array:
        """A smooth random function of time, (frames,) values from `low` to `high`."""
        periods = rng.uniform(*_PERIODS.T)
        phase = rng.uniform(0, 2 * np.pi, len(periods))
        weight = 1 / np.arange(1, len(periods) + 1)
        wave = np.sin(2 * np.pi * np.outer(time, periods) + phase) @ (weight / weight.sum())
        return np.asarray(low + 0.5 * (high - low) * (1 + wave))

    time = (np.arange(frames) + 0.5) / frames
    reach, middle = 0.45 * area_m, 0.15 * area_m
    x, y = course(-reach, reach), course(-reach, reach)
    east, north = course(-middle, middle) - x, course(-middle, middle) - y
    z = ground_height(x, y) + course(*altitude_m)
    return Aims(np.column_stack([x, y, z]), np.arctan2(east, north), np.radians(course(*pitch_deg)))
