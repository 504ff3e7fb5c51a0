"""Surveys of an area: lawn-mower, double grid and orbit, as a mission planner would fly them.

Poses are `cam_from_world` (N, 4, 4) float64: OpenCV axes (x right, y down, z forward), world
east-north-up metres with Z up. Headings are degrees clockwise from north, the direction the top of
the image (nadir) or the camera (oblique) points to; pitches are degrees, -90 straight down.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scene.errors import InputError
from simulate.flight.gimbal import gimbal_poses

Array = NDArray[np.float64]
GroundHeight = Callable[[Array, Array], Array]
"""Ground height in metres at world x, y (N,) metres, such as `World.terrain.height`."""

MAX_PHOTOGRAPHS = 20_000
"""Of one flight; a plan that needs more is taken for a mistake."""


def plan_nadir(
    area_m: float,
    ground_height: GroundHeight,
    *,
    width: int,
    height: int,
    focal: float,
    altitude_m: float,
    rng: np.random.Generator,
    frames: int | None = None,
    forward_overlap: float = 0.7,
    side_overlap: float = 0.6,
    heading_deg: float = 0.0,
    pitch_deg: float = -90.0,
    alternate: bool = True,
    terrain_following: bool = True,
    position_jitter_m: float = 0.0,
    attitude_jitter_deg: float = 0.0,
) -> Array:
    """A lawn-mower pattern over a square of `area_m` metres centred on the origin.

    Args:
        width, height, focal: of the pinhole camera, pixels.
        altitude_m: above the ground below each exposure, or above the ground at the origin
            without `terrain_following`.
        frames: exactly so many exposures, evenly spaced along all lines; None: as many as the
            overlaps (fractions of the footprint on flat ground) need.
        heading_deg: of the first line; every second line is flown the other way.
        alternate: whether the aircraft, and so the image, turns round on those lines.
        position_jitter_m, attitude_jitter_deg: standard deviations per axis.

    Returns:
        cam_from_world (N, 4, 4) float64 in flying order.

    Raises:
        InputError: an overlap outside [0, 0.95], a size, altitude or count that is not positive,
            or more photographs than a flight takes.
    """
    _require_positive(area_m=area_m, width=width, height=height, focal=focal, altitude_m=altitude_m)
    for name, overlap in (("forward_overlap", forward_overlap), ("side_overlap", side_overlap)):
        if not 0 <= overlap <= 0.95:
            raise InputError(f"{name} must be 0 to 0.95, got {overlap:g}")
    if frames is not None:
        _require_positive(frames=frames)
    along_m = (1 - forward_overlap) * height * altitude_m / focal
    across_m = (1 - side_overlap) * width * altitude_m / focal
    # Exposures stay inside the area by somewhat less than half a footprint, so that corners are
    # seen at any heading and little is seen of what lies outside.
    inset = 0.3 * min(width, height) * altitude_m / focal
    half = max(0.5 * area_m - inset, 0.1 * area_m)
    heading = np.radians(heading_deg)
    forward = np.array([np.sin(heading), np.cos(heading)])
    right = np.array([np.cos(heading), -np.sin(heading)])
    reach = half * np.abs(right).sum()  # of the rotated square, to either side

    if frames is None:
        lines = _few(2 * reach / across_m)
    else:
        # Lines and exposures as far apart as the footprint's sides are long.
        cell = np.sqrt((2 * half) ** 2 / frames * across_m / along_m)
        lines = max(1, min(frames, round(2 * reach / cell)))
    offsets = reach * (2 * (np.arange(lines) + 0.5) / lines - 1)
    if frames is None and lines > 1:
        offsets = np.linspace(-reach, reach, lines)
    starts, ends = _clip_lines(offsets, forward, right, half)

    lengths = ends - starts
    position, line = [], []
    if frames is None:
        _few((lengths / along_m).sum())
        for k in range(lines):
            count = _few(lengths[k] / along_m)
            share = np.linspace(0, 1, count) if count > 1 else np.array([0.5])
            position.append(share)
            line.append(np.full(count, k))
    else:
        # Walk all lines end to end in equal steps.
        total = np.concatenate([[0.0], np.cumsum(np.maximum(lengths, 1e-9))])
        at = (np.arange(frames) + 0.5) / frames * total[-1]
        which = np.clip(np.searchsorted(total, at, side="right") - 1, 0, lines - 1)
        position.append((at - total[which]) / (total[which + 1] - total[which]))
        line.append(which)
    s, k = np.concatenate(position), np.concatenate(line)
    back = k % 2 == 1
    s = np.where(back, 1 - s, s)
    xy = offsets[k, None] * right + (starts[k] + s * lengths[k])[:, None] * forward
    headings = np.where(back & alternate, heading + np.pi, heading)

    count = len(xy)
    xy = xy + position_jitter_m * rng.standard_normal((count, 2))
    below = xy if terrain_following else np.zeros((count, 2))
    z = ground_height(below[:, 0], below[:, 1]) + altitude_m
    z = z + position_jitter_m * rng.standard_normal(count)
    centres = np.column_stack([xy, z])
    return gimbal_poses(centres, headings, np.radians(pitch_deg), attitude_jitter_deg, rng)


def plan_grid(
    area_m: float,
    ground_height: GroundHeight,
    *,
    heading_deg: float,
    frames: int | None,
    **options: Any,
) -> Array:
    """A double grid: `plan_nadir` flown twice, the second time at right angles to the first.

    Args:
        frames: of both together, halved between them; None: as many as the overlaps need.
        options: as `plan_nadir` takes them, for both.

    Returns:
        cam_from_world (N, 4, 4) float64 in flying order.

    Raises:
        InputError: as `plan_nadir`, or fewer frames than two.
    """
    if frames is not None and frames < 2:
        raise InputError(f"a grid needs at least 2 frames, got {frames}")
    halves = (None, None) if frames is None else ((frames + 1) // 2, frames // 2)
    return np.concatenate(
        [
            plan_nadir(
                area_m, ground_height, heading_deg=heading_deg + turn, frames=half, **options
            )
            for turn, half in zip((0.0, 90.0), halves, strict=True)
        ]
    )


def plan_oblique(
    ground_height: GroundHeight,
    *,
    radius_m: float,
    altitude_m: float,
    frames: int,
    rng: np.random.Generator,
    pitch_deg: float = -45.0,
    centre: tuple[float, float] = (0.0, 0.0),
    start_deg: float = 0.0,
    position_jitter_m: float = 0.0,
    attitude_jitter_deg: float = 0.0,
) -> Array:
    """An orbit of `radius_m` around `centre` (metres), looking inwards at `pitch_deg`.

    Args:
        altitude_m: above the ground at the centre; the orbit is level.
        start_deg: bearing of the first exposure from the centre, clockwise from north.
        position_jitter_m, attitude_jitter_deg: standard deviations per axis.

    Returns:
        cam_from_world (frames, 4, 4) float64 in flying order.

    Raises:
        InputError: a radius, altitude or count that is not positive.
    """
    _require_positive(radius_m=radius_m, altitude_m=altitude_m, frames=frames)
    bearing = np.radians(start_deg) + 2 * np.pi * np.arange(frames) / frames
    out = np.column_stack([np.sin(bearing), np.cos(bearing)])
    xy = np.asarray(centre) + radius_m * out
    base = float(ground_height(np.array([centre[0]]), np.array([centre[1]]))[0])
    centres = np.column_stack([xy, np.full(frames, base + altitude_m)])
    centres = centres + position_jitter_m * rng.standard_normal((frames, 3))
    return gimbal_poses(centres, bearing + np.pi, np.radians(pitch_deg), attitude_jitter_deg, rng)


def _clip_lines(offsets: Array, forward: Array, right: Array, half: float) -> tuple[Array, Array]:
    """Where lines along `forward`, `offsets` (K,) to the right, enter and leave the square."""
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


def _few(steps: float) -> int:
    """Exposures, or lines, on a way of so many longest steps."""
    if steps > MAX_PHOTOGRAPHS:
        raise InputError(
            f"a flight takes at most {MAX_PHOTOGRAPHS} photographs: overlap less or fly higher"
        )
    return int(np.ceil(steps)) + 1


def _require_positive(**values: float) -> None:
    for name, value in values.items():
        if not value > 0:
            raise InputError(f"{name} must be positive, got {value:g}")
