"""Plan virtual photographs on a grid above the ground: nadir and oblique views."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.virtual.options import ViewOptions
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera

Array = NDArray[np.float64]

# Maximum number of views.
_MAX_VIEWS = 20_000
# Field of view of a wide lens of a drone, similar to that of queries.
_FOV_DEG: Final = 60.0
# Headings of the oblique views from one position, degrees clockwise from north.
_HEADINGS_DEG = (0.0, 90.0, 180.0, 270.0)


def make_camera(options: ViewOptions) -> Camera:
    """Return the pinhole camera of all views."""
    focal = options.size / 2 / math.tan(math.radians(_FOV_DEG) / 2)
    half = options.size / 2
    return Camera("PINHOLE", options.size, options.size, (focal, focal, half, half))


def lay_grid(low: Array, high: Array, altitude: float, options: ViewOptions) -> Array:
    """Return the horizontal positions (N, 2) of views, east and north, row by row.

    Args:
        low: (2,) west and south ends of the ground, world metres.
        high: (2,) east and north ends.
        altitude: height above the ground, metres.
        options: the overlap, and whether there are oblique views.

    Raises:
        InputError: there would be more than 20,000 views.
    """
    side = 2 * altitude * math.tan(math.radians(_FOV_DEG) / 2)
    # The outer quarter of the outermost views lies beyond the edge of the ground.
    low, high = low + side / 4, high - side / 4
    counts = np.ceil(np.maximum(high - low, 0) / (side * (1 - options.overlap))).astype(int) + 1
    views = int(counts.prod()) * (1 + len(_HEADINGS_DEG) * (options.tilt > 0))
    if views > _MAX_VIEWS:
        raise InputError(
            f"{views} views from {altitude:g} m above the ground are too many: choose a larger "
            "--altitude or a smaller orthophoto"
        )
    axes = [
        np.linspace(a, b, n) if n > 1 else np.array([(a + b) / 2])
        for a, b, n in zip(low, high, counts, strict=True)
    ]
    north, east = np.meshgrid(axes[1], axes[0], indexing="ij")
    return np.stack([east.ravel(), north.ravel()], -1)


def view_pose(centre: Array, heading_deg: float, tilt_deg: float) -> Array:
    """Return the pose ``cam_from_world`` (4, 4) of a view.

    Args:
        centre: (3,) world metres.
        heading_deg: direction of the top of a nadir view, and of an oblique view's optical axis,
            degrees clockwise from north.
        tilt_deg: angle between the optical axis and the vertical.
    """
    heading, tilt = math.radians(heading_deg), math.radians(tilt_deg)
    ahead = np.array([math.sin(heading), math.cos(heading), 0.0])
    right = np.array([math.cos(heading), -math.sin(heading), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    forward = math.sin(tilt) * ahead - math.cos(tilt) * up
    down = -math.cos(tilt) * ahead - math.sin(tilt) * up
    rotation = np.stack([right, down, forward])
    cam_from_world = np.eye(4)
    cam_from_world[:3, :3] = rotation
    cam_from_world[:3, 3] = -rotation @ centre
    return cam_from_world


def list_directions(options: ViewOptions) -> list[tuple[float, float]]:
    """Return heading and tilt of the views from one position, degrees."""
    oblique = [(heading, options.tilt) for heading in _HEADINGS_DEG] if options.tilt else []
    return [(0.0, 0.0), *oblique]
