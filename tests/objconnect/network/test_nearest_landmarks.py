"""Sums over objects near landmarks are those of the distances to the nearest landmarks."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from objconnect.network import nearest_landmarks
from objconnect.network.nearest_landmarks import NearestLandmarks


def complex_normal(rng: np.random.Generator, scale: float, count: int) -> NDArray[np.complex128]:
    return np.asarray(scale * (rng.normal(size=count) + 1j * rng.normal(size=count)), complex)


@pytest.mark.parametrize("extent", [40.0, 3000.0])
def test_sums_are_those_of_the_nearest_landmarks(
    extent: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where objects lie outside the grid, and where poses take more than one batch."""
    monkeypatch.setattr(nearest_landmarks, "_BATCH", 64)
    rng = np.random.default_rng(2)
    landmarks = complex_normal(rng, extent, 60) + (500 - 200j)
    nearest = NearestLandmarks(landmarks)
    ratio = rng.uniform(0, 3, (9, 60)).astype(np.float32)
    offset, rotation = complex_normal(rng, 0.5, 9), complex_normal(rng, 60.0, 150)
    # Half of the poses have the first object on a landmark.
    position = rng.choice(landmarks, 150) - rotation * offset[0]
    position[75:] = complex_normal(rng, extent, 75) + (500 - 200j)

    positions = position[:, None] + rotation[:, None] * offset
    rows, is_inside = nearest(positions)
    weight = np.exp(-0.5 * np.square(np.abs(landmarks[rows] - positions) / 1.5)) * is_inside
    expected = (ratio[np.arange(9), rows] * weight).sum(1)

    found = nearest.sum_near(ratio, offset, rotation, position, 1.5)
    assert not is_inside.all() and np.quantile(expected, 0.6) > 0.1
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_no_pose_has_no_sum() -> None:
    none, offset = np.zeros(0, complex), np.array([0j, 1j])
    nearest = NearestLandmarks(np.array([0j, 3 + 4j]))
    sums = nearest.sum_near(np.ones((2, 2), np.float32), offset, none, none, 1.5)
    assert sums.shape == (0,)
