"""Plan surveys of an area: a lawn-mower pattern, a double grid and an orbit.

Every planner takes the flight's configuration, its context (place, camera, wind), the number of
photographs and a generator of random numbers. It returns ``cam_from_world`` (N, 4, 4) float64 in
flying order: OpenCV axes (x right, y down, z forward), world east-north-up in metres with Z up.
Headings are the direction of the image's top (nadir) or of the optical axis (oblique), degrees
clockwise from north. Pitches are degrees above the horizon; -90 is straight down.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from simulate.flight.config import GridFlight, NadirFlight, ObliqueFlight
from simulate.flight.context import MAX_PHOTOGRAPHS, FlightContext
from simulate.flight.gimbal import Aims, gimbal_poses, perturb_poses

Array = NDArray[np.float64]

INSET_SHARE: Final = 0.3
"""Distance of exposures from the edge of the area, as a share of the shorter side of a footprint.
It is less than half, so that corners are seen at any heading and little is seen beyond the edge."""

# In small areas, lines extend at least this share of the side from the centre.
_LEAST_REACH_SHARE = 0.1


def plan_nadir(
    flight: NadirFlight | GridFlight,
    context: FlightContext,
    frames: int | None,
    rng: np.random.Generator,
    *,
    alternate: bool = True,
) -> Array:
    """Plan a lawn-mower pattern over the square area of the place.

    Args:
        flight: The survey. Its altitude is above the ground below each exposure, or above the
            ground at the origin without ``terrain_following``.
        context: The place, the camera and the wind.
        frames: The exact number of exposures, evenly spaced along all lines. None takes the number
            that the overlaps need.
        rng: The generator of the wind.
        alternate: Whether the aircraft, and with it the image, turns on every second line.

    Returns:
        The poses ``cam_from_world`` (N, 4, 4) float64 in flying order.

    Raises:
        InputError: The number of frames is not positive, or the flight takes too many photographs.
    """
    if frames is not None:
        _require_positive(frames)
    altitude_m = flight.altitude(context.camera.focal[0], context.defaults.nadir_altitude_m)
    heading_deg = flight.heading_deg
    heading = np.radians(context.defaults.nadir_heading_deg if heading_deg is None else heading_deg)
    forward = np.array([np.sin(heading), np.cos(heading)])
    right = np.array([np.cos(heading), -np.sin(heading)])
    lines = _lay_lines(flight, context, frames, forward, right)
    line, share = _exposures(lines, frames)
    back = line % 2 == 1
    share = np.where(back, 1 - share, share)
    along = lines.start[line] + share * lines.length[line]
    xy = lines.offset[line, None] * right + along[:, None] * forward

    count = len(xy)
    jitter_m = context.wind.position_jitter_m
    # The altitude is above the ground below the position with wind.
    xy = xy + jitter_m * rng.standard_normal((count, 2))
    below = xy if flight.terrain_following else np.zeros((count, 2))
    z = context.ground_height(below[:, 0], below[:, 1]) + altitude_m
    z = z + jitter_m * rng.standard_normal(count)
    headings = np.where(back & alternate, heading + np.pi, heading)
    pitch = np.radians(flight.pitch_deg)
    centres = np.column_stack([xy, z])
    return gimbal_poses(centres, headings, pitch, context.wind.attitude_jitter_deg, rng)


def plan_grid(
    flight: GridFlight, context: FlightContext, frames: int | None, rng: np.random.Generator
) -> Array:
    """Plan a double grid: two lawn-mower patterns, the second at right angles to the first.

    Args:
        flight: The survey; its heading is that of the first pattern.
        context: The place, the camera and the wind.
        frames: The number of exposures of both patterns together. None takes the number that the
            overlaps need.
        rng: The generator of the wind.

    Returns:
        The poses ``cam_from_world`` (N, 4, 4) float64 in flying order.

    Raises:
        InputError: As ``plan_nadir``, or there are fewer than two frames.
    """
    if frames is not None and frames < 2:
        raise InputError(f"a grid needs at least 2 frames, got {frames}")
    halves = (None, None) if frames is None else ((frames + 1) // 2, frames // 2)
    heading_deg = flight.heading_deg
    first_deg = context.defaults.nadir_heading_deg if heading_deg is None else heading_deg
    patterns = [
        plan_nadir(flight.model_copy(update={"heading_deg": first_deg + turn}), context, half, rng)
        for turn, half in zip((0.0, 90.0), halves, strict=True)
    ]
    return np.concatenate(patterns)


def plan_oblique(
    flight: ObliqueFlight, context: FlightContext, frames: int, rng: np.random.Generator
) -> Array:
    """Plan a level orbit whose cameras look inwards.

    Args:
        flight: The orbit; its altitude is above the ground at its centre.
        context: The place, the camera and the wind.
        frames: The number of exposures, evenly spaced.
        rng: The generator of the wind.

    Returns:
        The poses ``cam_from_world`` (frames, 4, 4) float64 in flying order.

    Raises:
        InputError: The number of frames is not positive.
    """
    _require_positive(frames)
    defaults = context.defaults
    radius_m = flight.radius_m or defaults.orbit_radius_share * context.side_m
    altitude_m = flight.altitude_m or defaults.orbit_altitude_m
    start_deg = defaults.orbit_start_deg if flight.start_deg is None else flight.start_deg
    bearing = np.radians(start_deg) + 2 * np.pi * np.arange(frames) / frames
    outwards = np.column_stack([np.sin(bearing), np.cos(bearing)])
    xy = np.asarray(flight.centre) + radius_m * outwards
    middle_x, middle_y = (np.array([value]) for value in flight.centre)
    ground = float(context.ground_height(middle_x, middle_y)[0])
    centres = np.column_stack([xy, np.full(frames, ground + altitude_m)])
    pitch = np.full(frames, np.radians(flight.pitch_deg))
    return perturb_poses(Aims(centres, bearing + np.pi, pitch), context.wind, rng)


class _Lines(NamedTuple):
    """Parallel flight lines over the area.

    Attributes:
        offset: Distance (K,) of each line to the right of the origin, metres.
        start: Position (K,) at which each line begins, metres from its point nearest to the origin.
        length: Length (K,) of each line, metres.
        spacing_m: The longest step (m) between exposures on a line that the overlap allows.
    """

    offset: Array
    start: Array
    length: Array
    spacing_m: float


def _lay_lines(
    flight: NadirFlight | GridFlight,
    context: FlightContext,
    frames: int | None,
    forward: Array,
    right: Array,
) -> _Lines:
    """Lay the lines of a lawn-mower pattern in the unit direction ``forward`` (2,)."""
    forward_overlap, side_overlap = flight.overlaps
    camera, focal = context.camera, context.camera.focal[0]
    altitude_m = flight.altitude(focal, context.defaults.nadir_altitude_m)
    along_m = (1 - forward_overlap) * camera.height * altitude_m / focal
    across_m = (1 - side_overlap) * camera.width * altitude_m / focal
    inset = INSET_SHARE * min(camera.width, camera.height) * altitude_m / focal
    half = max(0.5 * context.side_m - inset, _LEAST_REACH_SHARE * context.side_m)
    reach = half * np.abs(right).sum()  # extent of the rotated square to either side
    if frames is None:
        lines = _count_to_cover(2 * reach / across_m)
    else:
        # The distances of lines and of exposures have the ratio across_m : along_m.
        spacing_m = np.sqrt((2 * half) ** 2 / frames * across_m / along_m)
        lines = max(1, min(frames, round(2 * reach / spacing_m)))
    offset = reach * (2 * (np.arange(lines) + 0.5) / lines - 1)
    if frames is None and lines > 1:
        offset = np.linspace(-reach, reach, lines)
    start, end = _clip_lines(offset, forward, right, half)
    return _Lines(offset, start, end - start, along_m)


def _exposures(lines: _Lines, frames: int | None) -> tuple[NDArray[np.int64], Array]:
    """Return the line of each exposure (N,), and its position along it as a share (N,).

    Shares are counted from the line's start, also where the line is flown backwards.
    """
    if frames is not None:
        # Exposures are at equal steps along all lines joined end to end.
        total = np.concatenate([[0.0], np.cumsum(np.maximum(lines.length, 1e-9))])
        at = (np.arange(frames) + 0.5) / frames * total[-1]
        line = np.searchsorted(total, at, side="right") - 1
        line = np.clip(line, 0, len(lines.length) - 1)
        return line, (at - total[line]) / (total[line + 1] - total[line])
    _count_to_cover((lines.length / lines.spacing_m).sum())  # refuses too many photographs
    counts = [_count_to_cover(length / lines.spacing_m) for length in lines.length]
    shares = [np.linspace(0, 1, count) if count > 1 else np.array([0.5]) for count in counts]
    return np.repeat(np.arange(len(counts)), counts), np.concatenate(shares)


def _clip_lines(offsets: Array, forward: Array, right: Array, half: float) -> tuple[Array, Array]:
    """Clip flight lines to the square with half side ``half`` metres around the origin.

    The lines run along ``forward`` (2,), at ``offsets`` (K,) metres to the right of the origin.
    """
    foot = offsets[:, None] * right
    low = np.full(len(offsets), -np.inf)
    high = np.full(len(offsets), np.inf)
    for axis in range(2):
        if abs(forward[axis]) < 1e-9:
            continue
        a, b = ((edge - foot[:, axis]) / forward[axis] for edge in (-half, half))
        low, high = np.maximum(low, np.minimum(a, b)), np.minimum(high, np.maximum(a, b))
    middle = 0.5 * (low + high)  # a line that only touches a corner is a point
    return np.minimum(low, middle), np.maximum(high, middle)


def _count_to_cover(steps: float) -> int:
    """Return how many exposures, or lines, cover a length of ``steps`` largest allowed steps.

    Raises:
        InputError: The number exceeds ``MAX_PHOTOGRAPHS``.
    """
    if steps > MAX_PHOTOGRAPHS:
        raise InputError(
            f"the flight needs more than {MAX_PHOTOGRAPHS} photographs: overlap less or fly higher"
        )
    return int(np.ceil(steps)) + 1


def _require_positive(frames: int) -> None:
    if not frames > 0:
        raise InputError(f"frames must be positive, got {frames:g}")
