from __future__ import annotations

import numpy as np
import pytest
import torch
from baselines.upright import north, upright
from numpy.typing import NDArray

from scene.features import Features
from scene.pose import so3_exp

DOWN = np.diag([1.0, -1.0, -1.0])


def turned(degrees: float) -> NDArray[np.float64]:
    """A camera that looks down, its up turned clockwise (seen from above) from north."""
    heading = so3_exp(torch.tensor([0.0, 0.0, np.radians(degrees)], dtype=torch.float64)).numpy()
    return np.asarray(DOWN @ heading)


@pytest.mark.parametrize("heading", [0.0, 30.0, 90.0, 170.0, -120.0])
def test_north_is_where_the_ground_s_north_projects(heading: float) -> None:
    rotation = turned(heading)
    x, y, _ = rotation @ [0, 1, 0]
    assert north(rotation) == pytest.approx(np.arctan2(x, -y), abs=1e-9)


def test_an_oblique_view_along_north_is_upright_already() -> None:
    tilt = so3_exp(torch.tensor([np.radians(-50.0), 0.0, 0.0], dtype=torch.float64)).numpy()
    assert north(tilt @ DOWN) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("heading", [0.0, 90.0, 200.0])
def test_views_from_a_street_keep_the_sky_up(heading: float) -> None:
    level = so3_exp(torch.tensor([np.radians(-80.0), 0.0, 0.0], dtype=torch.float64)).numpy()
    assert north(level @ turned(heading)) == pytest.approx(0, abs=1e-9)


def _brightest(rgb: NDArray[np.uint8]) -> Features:
    """One keypoint at the centre of what is bright."""
    rows, columns = np.nonzero(rgb.max(2) > 128)
    xy = np.array([[columns.mean() + 0.5, rows.mean() + 0.5]], np.float32)
    return Features(xy, np.ones(1, np.float32), np.ones((1, 4), np.float32))


@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 2, 2.5, -1.0])
def test_keypoints_come_back_to_the_pixels_of_the_picture(angle: float) -> None:
    picture = np.zeros((80, 120, 3), np.uint8)
    picture[20:23, 90:93] = 255
    found = upright(_brightest, picture, angle)
    assert found.xy[0] == pytest.approx([91.5, 21.5], abs=0.3)


def test_what_pointed_north_points_up() -> None:
    # A camera flown east: its up is east, north is to its left.
    picture = np.zeros((100, 100, 3), np.uint8)
    picture[48:52, 10:14] = 255
    seen: list[NDArray[np.uint8]] = []

    def look(rgb: NDArray[np.uint8]) -> Features:
        seen.append(rgb)
        return _brightest(rgb)

    rotation = turned(90.0)
    side = np.sign((rotation @ [0, 1, 0])[0])
    upright(look, picture if side < 0 else picture[:, ::-1], north(rotation))
    rows, columns = np.nonzero(seen[0].max(2) > 128)
    assert rows.mean() < 20
    assert columns.mean() == pytest.approx(49.5, abs=2)


def test_the_edge_of_the_picture_is_no_feature() -> None:
    picture = np.zeros((80, 80, 3), np.uint8)
    picture[1:4, 1:4] = 255
    assert len(upright(_brightest, picture, 0.3).xy) == 0
