"""Measure how far points are from the ground of a place, including pavements and kerbs."""

from __future__ import annotations

import numpy as np

from objconnect.scene.bundle.labels import CLASSES
from simulate.place.kerbs import PavementHeights
from simulate.place.world import World

# Kerbs stand upright: a point this near to one may be anywhere on its side.
_NEAR_M = 0.03


def ground_error(world: World, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Distance (N,) in height of points (N,), world metres."""
    rises = PavementHeights(world.kerbs)
    around = [(0.0, 0.0), (_NEAR_M, 0.0), (-_NEAR_M, 0.0), (0.0, _NEAR_M), (0.0, -_NEAR_M)]
    found = np.zeros((len(around), len(x)))
    close = [world.ground.label(x + dx, y + dy) for dx in (-0.2, 0, 0.2) for dy in (-0.2, 0, 0.2)]
    for k in np.flatnonzero((np.array(close) == CLASSES["pavement"]).any(0)):
        found[:, k] = [rises.height_at(np.array([x[k] + dx, y[k] + dy])) for dx, dy in around]
    above = z - world.terrain.height(x, y)
    error: np.ndarray = np.maximum(0, np.maximum(found.min(0) - above, above - found.max(0)))
    return error
