"""Focal lengths from angles of view, to check stated focal lengths."""

from __future__ import annotations

import math
from typing import Final

MAX_DIFFERENCE: Final = 0.03
"""Relative difference above which focal lengths contradict each other. It is this large because
programs round angles to two or three digits, and compute them with and without distortion."""


def focal_lengths(angle: float, side: float, fisheye: bool) -> tuple[float, ...]:
    """Return the possible focal lengths (pixels) for an angle of view.

    Programs compute the angle of a fisheye by the pinhole or by the fisheye model.

    Args:
        angle: angle across the picture, radians.
        side: length of the picture along the angle, pixels.
        fisheye: whether the lens is a fisheye.

    Examples:
        >>> [round(value) for value in focal_lengths(math.pi / 2, 1000.0, True)]
        [500, 637]
    """
    focals = []
    if 0 < angle < math.pi:
        focals.append(side / 2 / math.tan(angle / 2))
    if fisheye and angle > 0:
        focals.append(side / angle)
    return tuple(focals)


def contradicts(focal: float, angle: float, side: float, fisheye: bool) -> bool:
    """Return whether a focal length (pixels) contradicts an angle of view."""
    return all(abs(f / focal - 1) > MAX_DIFFERENCE for f in focal_lengths(angle, side, fisheye))
