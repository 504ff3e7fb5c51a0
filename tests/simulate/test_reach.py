"""Objects that a frame leaves out cannot be seen in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simulate.camera.pinhole import PinholeCamera
from simulate.place.world import World
from simulate.render.job import RenderJob, frame_path
from simulate.render.pool import render
from simulate.render.reach import Reach
from tests.simulate.towns import cached_town

AREA = 500.0
LARGE_AREA = 720.0  # has 5,963 objects, of which those out of reach leave the scene
CAMERA = PinholeCamera(width=64, height=48, f=50.0, cx=32.0, cy=24.0)


def looking_down(x: float, y: float, z: float) -> np.ndarray:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = -pose[:3, :3] @ [x, y, z]
    return pose


def corners(away: float) -> dict[int, np.ndarray]:
    """Poses over two opposite corners, of which neither needs what stands at the other."""
    return {0: looking_down(-away, -away, 60), 1: looking_down(away, away, 60)}


CORNERS = corners(220)


@pytest.fixture(scope="module")
def town() -> World:
    return cached_town(3, AREA)


def test_objects_in_view_are_needed_and_those_far_away_are_not(town: World) -> None:
    centres = np.array([item.centre for item in town.objects])
    pose = CORNERS[0]
    needed = Reach(town.objects, 60.0)(CAMERA, pose, 0.0)
    local = centres @ pose[:3, :3].T + pose[:3, 3]
    u, v = (local[:, :2] / local[:, 2:]).T * CAMERA.f + [[CAMERA.cx], [CAMERA.cy]]
    seen = (u > 0) & (u < CAMERA.width) & (v > 0) & (v < CAMERA.height)
    assert seen.any() and needed[seen].all()
    away = np.linalg.norm(centres[:, :2] - [-220, -220], axis=1)
    assert needed[away < 200].all() and not needed[away > 500].any()


def test_shadows_of_a_low_sun_reach_farther(town: World) -> None:
    high, low = (Reach(town.objects, up)(CAMERA, CORNERS[0], 0.0) for up in (60.0, 8.0))
    assert low[high].all() and low.sum() > high.sum()


@pytest.mark.parametrize(
    ("area", "away"),
    [
        pytest.param(300.0, 130.0, id="they-move", marks=pytest.mark.thorough),
        pytest.param(LARGE_AREA, 300.0, id="they-leave", marks=pytest.mark.thorough),
    ],
)
def test_a_picture_is_the_same_whatever_was_rendered_before_it(
    tmp_path: Path, area: float, away: float
) -> None:
    poses = corners(away)
    pictures = {}
    for name, frames in (("both", (0, 1)), ("alone", (1,))):
        job = RenderJob(
            seed=3, side_m=area, condition="summer-noon", camera=CAMERA, samples=1,
            poses={i: poses[i].tolist() for i in frames},
        )  # fmt: skip
        render(job, tmp_path / name)
        with np.load(frame_path(tmp_path / name, 1)) as arrays:
            pictures[name] = dict(arrays)
    assert pictures["both"]["instance"].any()
    for layer, values in pictures["both"].items():
        assert np.array_equal(values, pictures["alone"][layer]), layer
