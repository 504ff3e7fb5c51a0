"""Angles of view, which state a focal length a second time."""

from __future__ import annotations

import math
from typing import Final

DIFFERENT: Final = 0.03
"""Focal lengths contradict each other where they differ by more than this part: programs round
angles to two or three digits, and compute them with and without distortion."""


def focal_lengths(angle: float, side: float, fisheye: bool) -> tuple[float, ...]:
    """Return the focal lengths (pixels) that an angle of view may mean.

    Programs compute the angle of a fisheye as that of a pinhole camera or as its own.

    Args:
        angle: angle across the picture, radians.
        side: the side of the picture along which it is, pixels.
        fisheye: whether the lens is a fisheye.

    Example:
        >>> [round(value) for value in focal_lengths(math.pi / 2, 1000.0, True)]
        [500, 637]
    """
    found = []
    if 0 < angle < math.pi:
        found.append(side / 2 / math.tan(angle / 2))
    if fisheye and angle > 0:
        found.append(side / angle)
    return tuple(found)


def contradicts(focal: float, angle: float, side: float, fisheye: bool) -> bool:
    """Return whether a focal length (pixels) is none that the angle of view may mean."""
    return all(abs(f / focal - 1) > DIFFERENT for f in focal_lengths(angle, side, fisheye))
