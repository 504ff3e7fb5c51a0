"""Rectangles on the ground, seen from above."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def rectangle(centre: ArrayLike, size: ArrayLike, yaw: float) -> NDArray[np.float64]:
    """Return the corners of a rectangle, (4, 2) metres.

    Args:
        centre: centre, (2,) metres.
        size: side lengths before rotation, (2,) metres.
        yaw: rotation counter-clockwise, radians.
    """
    cos, sin = np.cos(yaw), np.sin(yaw)
    corners = 0.5 * np.asarray(size) * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(np.asarray(centre) + corners @ np.array([[cos, sin], [-sin, cos]]))


def overlap(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Return whether two rectangles, given by their corners (4, 2), share any area.

    It uses the separating axis theorem.
    """
    for edges in (a, b):
        for axis in (edges[1] - edges[0], edges[2] - edges[1]):
            pa, pb = a @ axis, b @ axis
            if pa.max() <= pb.min() or pb.max() <= pa.min():
                return False
    return True
