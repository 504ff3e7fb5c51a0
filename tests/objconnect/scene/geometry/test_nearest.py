"""The index returns the same neighbours as a search over all points."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from objconnect.scene.geometry.nearest import NearestNeighbours


def all_looked_at(xy: NDArray[np.float64], place: NDArray[np.float64], k: int) -> NDArray[np.int64]:
    return np.argsort(np.square(xy - place).sum(1), kind="stable")[:k]


@pytest.mark.parametrize("count", [0, 1, 7, 3000])
@pytest.mark.parametrize("k", [0, 1, 5, 50])
@pytest.mark.parametrize("kind", ["anywhere", "grid", "one east", "one place", "strays"])
def test_as_all_looked_at(count: int, k: int, kind: str) -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-500, 500, (count, 2))
    if kind == "grid":
        xy = xy.round(-2)  # many points coincide
    elif kind == "one east":
        xy[:, 0] = 3.0
    elif kind == "one place":
        xy[:] = 3.0
    elif kind == "strays":
        xy[::3] *= 1e6
    nearest = NearestNeighbours(xy)
    for place in (*rng.uniform(-600, 600, (4, 2)), *xy[:2], np.array([1e9, -1e9])):
        np.testing.assert_array_equal(nearest(place, k), all_looked_at(xy, place, k))
        away = np.linalg.norm(xy - place, axis=1)
        for radius in (0.0, 100.0, 700.0):
            assert nearest.within(place, radius).tolist() == np.flatnonzero(away <= radius).tolist()


def test_nowhere() -> None:
    with pytest.raises(ValueError, match="the point must be finite"):
        NearestNeighbours(np.zeros((3, 2)))(np.array([0, np.nan]), 1)
