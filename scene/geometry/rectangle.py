"""Rectangles on the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def rectangle(centre: ArrayLike, size: ArrayLike, yaw: float) -> NDArray[np.float64]:
    """Corners (4, 2) of a rectangle with `centre` (2,), `size` (2,) metres and `yaw` radians."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    corners = 0.5 * np.asarray(size) * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(np.asarray(centre) + corners @ np.array([[cos, sin], [-sin, cos]]))


def overlap(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Whether two rectangles, (4, 2) corners each, share any area (separating axes)."""
    for edges in (a, b):
        for axis in (edges[1] - edges[0], edges[2] - edges[1]):
            pa, pb = a @ axis, b @ axis
            if pa.max() <= pb.min() or pb.max() <= pa.min():
                return False
    return True
