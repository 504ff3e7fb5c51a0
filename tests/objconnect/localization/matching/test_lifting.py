from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from objconnect.localization.matching.lifting import find_observations, interpolate_points
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.sparse_map import MapImage

CAMERA = Camera("SIMPLE_RADIAL", 320, 240, (280.0, 160.0, 120.0, -0.05))


def photograph(xy: NDArray[np.float64]) -> tuple[MapImage, Pose]:
    """A photograph that observes one point at each pixel, and where it stands."""
    pose = Pose.exp(torch.tensor([0.3, -0.2, 0.1, 5.0, -3.0, 40.0], dtype=torch.float64))
    image = MapImage("a.jpg", CAMERA, pose.matrix().numpy(), xy, np.arange(len(xy)))
    return image, pose


def place_on_rays(
    xy: NDArray[np.float64], depth: NDArray[np.float64], pose: Pose
) -> NDArray[np.float64]:
    rays, _ = CAMERA.unproject(torch.from_numpy(xy))
    return np.asarray(pose.inverse().transform(rays * torch.from_numpy(depth)[:, None]))


def slope(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Depths of a slanted plane: its inverse depth is affine over the rays."""
    rays, _ = CAMERA.unproject(torch.from_numpy(xy))
    return np.asarray(1 / (0.02 + 0.004 * rays[:, 0] - 0.006 * rays[:, 1]))


@pytest.fixture
def observed() -> NDArray[np.float64]:
    return np.random.default_rng(0).uniform([10, 10], [310, 230], (400, 2))


@pytest.fixture
def keypoints() -> NDArray[np.float32]:
    return np.random.default_rng(1).uniform([40, 40], [280, 200], (100, 2)).astype(np.float32)


def test_a_keypoint_carries_the_point_seen_there_and_none_further_away() -> None:
    xy = np.array([[10, 10], [10.9, 10], [12, 10], [50, 50]], np.float32)
    observations = np.array([[10.0, 10.0], [50.5, 50.5], [12.0, 10.0]])
    # The third observation has no point, the second is seen by the last keypoint.
    image = MapImage("a.jpg", CAMERA, np.eye(4), observations, np.array([7, 3, -1]))
    assert find_observations(xy, image).tolist() == [7, 7, -1, 3]


def test_points_between_observations_of_a_plane_are_exact(
    observed: NDArray[np.float64], keypoints: NDArray[np.float32]
) -> None:
    image, pose = photograph(observed)
    xyz = place_on_rays(observed, slope(observed), pose)
    points = interpolate_points(keypoints, image, xyz)
    exact = keypoints.astype(np.float64)
    np.testing.assert_allclose(points, place_on_rays(exact, slope(exact), pose), atol=1e-9)


def test_nothing_is_said_where_the_depths_disagree(
    observed: NDArray[np.float64], keypoints: NDArray[np.float32]
) -> None:
    """A roof 10 m over the ground in one half of the picture."""
    depth = np.where(observed[:, 0] < 160, 50.0, 40.0)
    image, pose = photograph(observed)
    points = interpolate_points(keypoints, image, place_on_rays(observed, depth, pose))
    given = np.isfinite(points).all(1)
    local = pose.transform(torch.from_numpy(points[given])).numpy()
    truth = np.where(keypoints[given, 0] < 160, 50.0, 40.0)
    np.testing.assert_allclose(local[:, 2], truth, rtol=1e-9)
    assert not given[np.abs(keypoints[:, 0] - 160) < 4].any()
    assert given[np.abs(keypoints[:, 0] - 160) > 40].all()


def test_nothing_is_said_far_from_all_observations(keypoints: NDArray[np.float32]) -> None:
    corner = np.random.default_rng(2).uniform(0, 20, (50, 2))
    image, pose = photograph(corner)
    away = keypoints[keypoints.min(1) > 60]
    points = interpolate_points(away, image, place_on_rays(corner, slope(corner), pose))
    assert np.isnan(points).all()


@pytest.mark.parametrize("observations", [0, 1, 5])
def test_a_few_observations_say_nothing(
    observations: int, observed: NDArray[np.float64], keypoints: NDArray[np.float32]
) -> None:
    few = observed[:observations]
    image, pose = photograph(few)
    assert np.isnan(
        interpolate_points(keypoints, image, place_on_rays(few, slope(few), pose))
    ).all()
    assert interpolate_points(keypoints[:0], image, place_on_rays(few, slope(few), pose)).shape == (
        0,
        3,
    )
