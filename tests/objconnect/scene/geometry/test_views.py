from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from objconnect.localization.matching.features import Extractor
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose, so3_exp
from objconnect.scene.geometry.views import (
    level_image,
    level_rotation,
    map_angle,
    north_angle,
    roll_rotation,
    rotate_north_up,
    tilt,
    warp_image,
)
from objconnect.scene.maps.features import Features

DOWN = np.diag([1.0, -1.0, -1.0])


def turn_by(degrees: float) -> NDArray[np.float64]:
    """A camera that looks down, its up turned clockwise (seen from above) from north."""
    heading = so3_exp(torch.tensor([0.0, 0.0, np.radians(degrees)], dtype=torch.float64)).numpy()
    return np.asarray(DOWN @ heading)


@pytest.mark.parametrize("heading", [0.0, 30.0, 90.0, 170.0, -120.0])
def test_north_is_where_the_ground_s_north_projects(heading: float) -> None:
    rotation = turn_by(heading)
    x, y, _ = rotation @ [0, 1, 0]
    assert north_angle(rotation) == pytest.approx(np.arctan2(x, -y), abs=1e-9)


def test_an_oblique_view_along_north_is_upright_already() -> None:
    oblique = so3_exp(torch.tensor([np.radians(-50.0), 0.0, 0.0], dtype=torch.float64)).numpy()
    assert north_angle(oblique @ DOWN) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("heading", [0.0, 90.0, 200.0])
def test_views_from_a_street_keep_the_sky_up(heading: float) -> None:
    level = so3_exp(torch.tensor([np.radians(-80.0), 0.0, 0.0], dtype=torch.float64)).numpy()
    assert north_angle(level @ turn_by(heading)) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("heading", [0.0, 1.0, 3.0, -2.0])
def test_a_camera_turned_about_its_axis_looks_at_the_same(heading: float) -> None:
    tilt = so3_exp(torch.tensor([np.radians(-20.0), 0.1, 0.0], dtype=torch.float64)).numpy()
    rotation = tilt @ turn_by(70)
    other = roll_rotation(-heading) @ rotate_north_up(rotation)
    assert north_angle(other) == pytest.approx(heading, abs=1e-9)
    np.testing.assert_allclose(other[2], rotation[2])


class Brightest(Extractor):
    """One keypoint at the centre of what is bright."""

    name = "brightest"
    options = ""

    def __call__(self, rgb: NDArray[np.uint8]) -> Features:
        rows, columns = np.nonzero(rgb.max(2) > 100)
        xy = np.array([[columns.mean() + 0.5, rows.mean() + 0.5]], np.float32)
        return Features(xy, np.ones(1, np.float32), np.ones((1, 4), np.float32))


LENS = Camera("OPENCV", 120, 80, (90.0, 90.0, 61.0, 38.0, -0.1, 0.02, 0.004, -0.003))
FULL = Camera("FULL_OPENCV", 120, 80, (*LENS.params, 0.02, 0.2, -0.05, 0.01))
OBLONG = Camera("PINHOLE", 120, 80, (90.0, 99.0, 58.0, 41.0))
FISHEYE = Camera("OPENCV_FISHEYE", 120, 80, (60.0, 60.0, 61.0, 38.0, 0.01, -0.002, 0.0, 0.0))
ANGLES = [0.0, 0.4, np.pi / 2, 2.5, -1.0]


def spot(x: int, y: int) -> NDArray[np.uint8]:
    picture = np.zeros((80, 120, 3), np.uint8)
    picture[y - 1 : y + 2, x - 1 : x + 2] = 255
    return picture


@pytest.mark.parametrize("angle", ANGLES)
def test_keypoints_come_back_to_the_pixels_of_the_picture(angle: float) -> None:
    found = Brightest().extract_warped(spot(91, 21), OBLONG, angle)
    assert found.xy[0] == pytest.approx([91.5, 21.5], abs=0.3)


def test_the_edge_of_the_picture_is_no_feature() -> None:
    assert len(Brightest().extract_warped(spot(2, 2), OBLONG, 0.3).xy) == 0


@pytest.mark.parametrize("camera", [LENS, FULL, OBLONG, FISHEYE], ids=lambda camera: camera.model)
@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("scale", [1.0, 0.6, 1.7])
def test_a_view_is_what_its_camera_sees(camera: Camera, angle: float, scale: float) -> None:
    """A point is where the turned camera projects it, which is where the photograph shows it."""
    points = torch.tensor([[0.4, -0.3, 1.0], [-0.5, 0.3, 1.2], [0.1, 0.2, 0.9]]).double()
    there = camera.project(points).xy.numpy()
    for point, (x, y) in zip(points, there, strict=True):
        seen = warp_image(spot(int(x), int(y)), camera, angle, scale)
        turned_point = point @ torch.from_numpy(seen.view_from_camera).T
        xy = seen.camera.project(turned_point[None]).xy.numpy()
        assert seen.in_photograph(xy)[0] == pytest.approx([x, y], abs=1e-6)
        light = seen.picture[..., 0].astype(float)
        x_light = (light.sum(0) @ (np.arange(seen.camera.width) + 0.5)) / light.sum()
        y_light = (light.sum(1) @ (np.arange(seen.camera.height) + 0.5)) / light.sum()
        found = seen.in_photograph(np.array([[x_light, y_light]]))[0]
        assert found == pytest.approx([int(x) + 0.5, int(y) + 0.5], abs=0.25)


@pytest.mark.parametrize("camera", [LENS, FULL, OBLONG, FISHEYE], ids=lambda camera: camera.model)
@pytest.mark.parametrize("scale", [1.0, 0.6])
def test_a_levelled_view_is_what_its_camera_sees(camera: Camera, scale: float) -> None:
    turn = Rotation.from_euler("xz", [25, 10], degrees=True).as_matrix()
    points = torch.tensor([[0.2, -0.2, 1.0], [-0.2, 0.2, 1.2], [0.1, 0.2, 0.9]]).double()
    there = camera.project(points).xy.numpy()
    for point, (x, y) in zip(points, there, strict=True):
        seen = level_image(spot(int(x), int(y)), camera, turn, scale)
        xy = seen.camera.project((point @ torch.from_numpy(turn).T)[None]).xy.numpy()
        assert seen.in_photograph(xy)[0] == pytest.approx([x, y], abs=1e-3)
        assert seen.shows(xy).all()
        light = seen.picture[..., 0].astype(float)
        x_light = (light.sum(0) @ (np.arange(seen.camera.width) + 0.5)) / light.sum()
        y_light = (light.sum(1) @ (np.arange(seen.camera.height) + 0.5)) / light.sum()
        found = seen.in_photograph(np.array([[x_light, y_light]]))[0]
        assert found == pytest.approx([int(x) + 0.5, int(y) + 0.5], abs=0.5)


def test_rays_behind_a_pinhole_camera_show_nothing() -> None:
    turn = Rotation.from_euler("xz", [45, 10], degrees=True).as_matrix()
    seen = level_image(np.zeros((80, 120, 3), np.uint8), OBLONG, turn, 1.0)
    xy = np.random.default_rng(0).uniform(-2000, 2000, (500, 2))
    rays, _ = seen.camera.unproject(torch.from_numpy(xy))
    there = OBLONG.project(rays.double() @ torch.from_numpy(turn))
    expected = np.where(there.valid[:, None].numpy(), there.xy.numpy(), np.nan)
    assert 0.1 < np.isnan(expected).mean() < 0.9
    np.testing.assert_allclose(seen.in_photograph(xy), expected, rtol=1e-9)


def test_a_camera_is_levelled_to_the_tilt_asked_for() -> None:
    for degrees, least, left in [(60, 30, 30), (60, 0, 15), (20, 30, 20), (80, 30, 35)]:
        flat = Rotation.from_euler("zx", [130, degrees], degrees=True).as_matrix() @ DOWN
        turned = level_rotation(flat, math.radians(least))
        assert math.degrees(tilt(flat)) == pytest.approx(degrees)
        assert math.degrees(tilt(turned)) == pytest.approx(left)
        assert map_angle(turned) == pytest.approx(0, abs=1e-9)


def test_a_levelled_view_never_has_many_more_pixels_than_the_photograph() -> None:
    wide = Camera("PINHOLE", 200, 150, (60.0, 60.0, 100.0, 75.0))
    turn = Rotation.from_euler("x", 45, degrees=True).as_matrix()
    seen = level_image(np.full((150, 200, 3), 200, np.uint8), wide, turn, 1.0)
    assert seen.camera.width * seen.camera.height < 2.05 * 200 * 150
    x, y = np.meshgrid(np.arange(seen.camera.width) + 0.5, np.arange(seen.camera.height) + 0.5)
    shown = seen.shows(np.stack([x, y], -1))
    assert (seen.picture[shown] == 200).all() and shown.any() and not shown.all()


def test_poses_and_covariances_come_back() -> None:
    seen = warp_image(spot(50, 40), LENS, 0.7)
    pose = Pose.exp(torch.tensor([0.1, -0.2, 0.3, 4.0, 5.0, 6.0], dtype=torch.float64))
    back = seen.photograph_pose(seen.pose(pose))
    np.testing.assert_allclose(back.matrix(), pose.matrix(), atol=1e-12)
    # A small motion of the view, brought back, is the tangent brought back.
    tangent = 1e-4 * torch.tensor([1.0, 2.0, -1.0, 3.0, -2.0, 1.0], dtype=torch.float64)
    moved = seen.photograph_pose(Pose.exp(tangent) @ seen.pose(pose))
    own = (moved @ pose.inverse()).log().numpy()
    outer = seen.photograph_covariance(np.outer(tangent, tangent))
    np.testing.assert_allclose(outer, np.outer(own, own), atol=1e-11)
    unknown = np.diag(np.full(6, np.inf))
    np.testing.assert_array_equal(seen.photograph_covariance(unknown), unknown)


def test_what_is_left_of_a_turned_picture_is_known() -> None:
    seen = warp_image(np.full((80, 120, 3), 200, np.uint8), OBLONG, 0.5)
    x, y = np.meshgrid(np.arange(seen.camera.width) + 0.5, np.arange(seen.camera.height) + 0.5)
    shown = seen.shows(np.stack([x, y], -1))
    assert (seen.picture[shown] == 200).all()
    assert 0.6 < shown.sum() / (80 * 120) < 0.85
