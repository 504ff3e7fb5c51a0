"""Rain and snow in front of the camera: where, how bright, and equal for equal seeds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from simulate.camera.pinhole import PinholeCamera
from simulate.look.conditions import condition
from simulate.render.precipitation import draw_precipitation

CAMERA = PinholeCamera(width=320, height=240, f=280.0, cx=160.0, cy=120.0)
DARK = np.full((240, 320, 3), 40, np.uint8)
LEVEL = np.eye(4)
LEVEL[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # looks north
DOWN = np.eye(4)
DOWN[:3, :3] = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]


def fall(name: str, pose: NDArray[np.float64] = DOWN, seed: int = 0) -> NDArray[np.uint8]:
    return draw_precipitation(DARK, CAMERA, pose, condition(name), np.random.default_rng(seed))


def test_nothing_falls_from_other_skies() -> None:
    for name in ("summer-noon", "autumn-noon-wet", "snow-dusk", "winter-noon-fog"):
        assert fall(name) is DARK


@pytest.mark.parametrize("name", ["summer-noon-rain", "winter-noon-snowfall"])
def test_particles_are_brighter_than_the_ground_and_repeat(name: str) -> None:
    shot = fall(name)
    assert (shot >= DARK).all()
    hit = (shot > DARK + 3).any(-1)
    assert 0.005 < hit.mean() < 0.5
    assert np.array_equal(shot, fall(name))
    assert not np.array_equal(shot, fall(name, seed=1))
    assert (DARK == 40).all()


def test_rain_falls_down_the_picture() -> None:
    """Streaks are longer than wide: neighbours along them are alike, in level views vertically."""
    shots = [fall("summer-noon-rain", LEVEL, seed)[..., 1].astype(float) for seed in range(6)]
    step = [np.mean([np.abs(np.diff(s, axis=axis)).mean() for s in shots]) for axis in (0, 1)]
    assert step[0] < 0.75 * step[1]


def test_nights_show_less_of_it() -> None:
    day, night = (fall(f"winter-{light}-snowfall").mean() for light in ("noon", "night"))
    assert night < day
