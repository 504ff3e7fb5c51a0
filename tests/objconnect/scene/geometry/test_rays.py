from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from objconnect.scene.geometry.rays import Rays

PLACE = np.array([3.0, -2.0, 55.0])
ORIGINS = np.array([[0.0, 0, 50], [20, 0, 50], [0, 25, 52], [30, 30, 49], [-20, 10, 60]])


def rays(origins: NDArray[np.float64] = ORIGINS, place: NDArray[np.float64] = PLACE) -> Rays:
    way = place - origins
    directions = way / np.linalg.norm(way, axis=1, keepdims=True)
    return Rays(origins, directions, np.repeat(np.eye(3)[None], len(origins), 0))


def turn(degrees: float) -> NDArray[np.float64]:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def test_exact_rays_meet_exactly() -> None:
    np.testing.assert_allclose(rays().intersect(), PLACE, atol=1e-9)
    assert rays().consensus(1, 5).tolist() == [0, 1, 2, 3, 4]


def test_two_of_five_wrong_rays_are_left_out() -> None:
    good = rays()
    directions = good.directions.copy()
    directions[1] *= -1
    directions[3] = [1, 0, 0]
    wrong = Rays(good.origins, directions, good.rotations)
    chosen = wrong.consensus(2, 5)
    assert chosen.tolist() == [0, 2, 4]
    np.testing.assert_allclose(wrong[chosen].intersect(), PLACE, atol=1e-9)


def test_a_reference_that_disagrees_on_the_attitude_is_left_out() -> None:
    good = rays()
    rotations = good.rotations.copy()
    rotations[2] = turn(10)
    assert Rays(good.origins, good.directions, rotations).consensus(2, 5).tolist() == [0, 1, 3, 4]


def test_rays_that_meet_behind_the_references_say_nothing() -> None:
    """Both cameras would have to look backwards."""
    good = rays(ORIGINS[:2])
    assert not len(Rays(good.origins, -good.directions, good.rotations).consensus(2, 5))


@pytest.mark.parametrize("number", [0, 1])
def test_fewer_than_two_say_nothing(number: int) -> None:
    assert not len(rays(ORIGINS[:number]).consensus(2, 5))


def test_references_in_line_with_the_place_say_nothing() -> None:
    line = np.array([[0.0, 0, 50], [10, 0, 50], [20, 0, 50]])
    one = rays(line, np.array([35.0, 0.5, 50]))
    assert one.widest_angle_deg() < 2
    assert not len(one.consensus(5, 5))


def test_the_nearer_of_two_noisy_rays_counts_for_more() -> None:
    """An angle of half a degree is 9 cm at 10 m and 9 m at a kilometre."""
    origins = np.array([[-10.0, 0, 0], [0, -10.0, 0], [0, 1000.0, 500]])
    good = rays(origins, np.zeros(3))
    directions = good.directions.copy()
    directions[2] = directions[2] @ turn(0.5)
    off = np.linalg.norm(Rays(origins, directions, good.rotations).intersect())
    assert off < 0.02


def test_the_mean_attitude_is_between() -> None:
    good = rays(ORIGINS[:2])
    both = Rays(good.origins, good.directions, np.stack([turn(4), turn(8)]))
    np.testing.assert_allclose(both.attitude(), turn(6), atol=1e-12)
