from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.prior import PriorConfig, PriorLocalizer
from objconnect.localization.initial_poses import list_initial_poses
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose, so3_exp
from objconnect.scene.geometry.views import north_angle
from objconnect.scene.localizer import PoseSource, Prior, Query, Status
from objconnect.scene.maps.sparse_map import MapImage, SparseMap

CAMERA = Camera("PINHOLE", 64, 48, (60.0, 60.0, 32.0, 24.0))
HEADINGS = (10.0, 30.0, -170.0, 100.0)
FLOWN = 40.0


def looking_down(heading: float, x: float) -> Pose:
    down = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    turn = so3_exp(torch.tensor([0.0, 0.0, np.radians(heading)], dtype=torch.float64))
    rotation = down @ turn
    return Pose(rotation, -rotation @ torch.tensor([x, 0.0, FLOWN], dtype=torch.float64))


@pytest.fixture(scope="module")
def sparse_map() -> SparseMap:
    """Photographs 10 m apart, turned by ``HEADINGS``, over level ground."""
    x, y = np.meshgrid(np.arange(-20.0, 51), np.arange(-20.0, 21))
    xyz = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1)
    images = {}
    for number, heading in enumerate(HEADINGS):
        pose = looking_down(heading, 10.0 * number).matrix().numpy()
        images[f"{number}"] = MapImage(
            f"{number}", CAMERA, pose, np.empty((0, 2)), np.empty(0, np.int64)
        )
    empty = np.zeros(len(xyz))
    return SparseMap(images, xyz, np.zeros((len(xyz), 3), np.uint8), empty, empty.astype(np.int64))


def headings(poses: list[Pose]) -> list[float]:
    return [np.degrees(north_angle(pose.rotation.numpy())) for pose in poses]


EVERY = np.arange(len(HEADINGS))
POSITION = np.array([3.0, 1.0, 35.0])


def test_a_known_pose_is_where_to_start(sparse_map: SparseMap) -> None:
    pose = looking_down(77.0, 5.0)
    prior = Prior(pose.centre().numpy(), np.ones(3), pose.rotation.numpy())
    (start,) = list_initial_poses(prior, sparse_map, EVERY)
    np.testing.assert_allclose(start.matrix(), pose.matrix(), atol=1e-12)


def test_every_heading_once_where_attitude_is_unknown(sparse_map: SparseMap) -> None:
    found = list_initial_poses(Prior(POSITION), sparse_map, EVERY)
    np.testing.assert_allclose(np.abs(headings(found)), [10, 170, 100], atol=1e-6)
    for pose in found:
        np.testing.assert_allclose(pose.centre(), POSITION, atol=1e-9)
    assert len(list_initial_poses(Prior(POSITION), sparse_map, EVERY[:2])) == 1


@pytest.mark.parametrize(("sigma", "height"), [(1.0, 35.0), (30.0, FLOWN), (np.inf, FLOWN)])
def test_an_altitude_nobody_knows_is_the_photograph_s(
    sparse_map: SparseMap, sigma: float, height: float
) -> None:
    prior = Prior(POSITION, np.array([2.0, 2.0, sigma]))
    for pose in list_initial_poses(prior, sparse_map, EVERY[1:]):
        np.testing.assert_allclose(pose.centre(), [3, 1, height], atol=1e-9)


def test_where_photographs_are_at_several_heights_each_is_tried(sparse_map: SparseMap) -> None:
    images = dict(sparse_map.images)
    for name, height in (("1", 25.0), ("3", 27.0)):
        image = images[name]
        centre = torch.from_numpy(np.array([*image.centre[:2], height]))
        lower = Pose(image.pose.rotation, -image.pose.rotation @ centre)
        images[name] = replace(image, cam_from_world=lower.matrix().numpy())
    climbing = replace(sparse_map, images=images)
    attitude = looking_down(77.0, 0.0).rotation.numpy()
    for sigma, altitudes in ((1.0, [35]), (np.inf, [FLOWN, 25])):
        prior = Prior(POSITION, np.array([2.0, 2.0, sigma]), attitude)
        found = list_initial_poses(prior, climbing, EVERY)
        centres = [pose.centre().numpy() for pose in found]
        np.testing.assert_allclose(centres, [[3, 1, z] for z in altitudes], atol=1e-9)
    unknown = list_initial_poses(Prior(POSITION, np.array([2.0, 2.0, np.inf])), climbing, EVERY)
    heights = [float(pose.centre()[2]) for pose in unknown]
    assert heights == sorted(heights, reverse=True)
    assert heights.count(heights[0]) == heights.count(heights[-1]) > 0


def test_without_prior_at_the_photographs(sparse_map: SparseMap) -> None:
    found = list_initial_poses(None, sparse_map, EVERY)
    centres = np.array([pose.centre().numpy() for pose in found])
    np.testing.assert_allclose(centres[:, 0], [0, 20, 30], atol=1e-9)


def test_the_floor_is_the_first_start(sparse_map: SparseMap) -> None:
    floor = PriorLocalizer(PriorConfig())
    floor.prepare(sparse_map, Path("nowhere"))
    query = Query("q", np.zeros((48, 64, 3), np.uint8), CAMERA, Prior(POSITION))
    answer = floor.localize(query)
    assert answer.status is Status.OK and answer.cam_from_world is not None
    assert answer.by is PoseSource.PRIOR
    (begin, *_) = list_initial_poses(query.prior, sparse_map, EVERY)
    np.testing.assert_array_equal(answer.cam_from_world.matrix(), begin.matrix())
    named = floor.localize(replace(query, prior=None, references=("2",)))
    assert named.cam_from_world is not None and named.by is PoseSource.RETRIEVAL
    np.testing.assert_allclose(named.cam_from_world.centre(), [20, 0, FLOWN], atol=1e-9)
    assert floor.localize(replace(query, prior=None)).status is Status.FAILED
    assert floor.localize(replace(query, references=())).status is Status.FAILED
    unknown = Prior(POSITION, np.full(3, np.inf), looking_down(77.0, 0.0).rotation.numpy(), 2.0)
    assert floor.localize(replace(query, prior=unknown)).status is Status.FAILED
    assert "not finite" in floor.localize(replace(query, prior=Prior(POSITION * np.nan))).reason


def test_what_is_known_in_part_is_used_in_part(sparse_map: SparseMap) -> None:
    level = looking_down(77.0, 0.0).rotation.numpy()
    whole = Prior(POSITION, np.full(3, 5.0), level, 2.0)
    assert whole.has_position and whole.has_heading
    gravity = replace(whole, heading_sigma_deg=np.inf)
    assert headings(list_initial_poses(gravity, sparse_map, EVERY)) == headings(
        list_initial_poses(Prior(POSITION, np.full(3, 5.0)), sparse_map, EVERY)
    )
    compass = replace(whole, position_sigma=np.array([np.inf, np.inf, 1.0]))
    begun = list_initial_poses(compass, sparse_map, EVERY)
    centres = np.array([pose.centre().numpy() for pose in begun])
    np.testing.assert_allclose(centres[:, 0], [0, 10, 20, 30], atol=1e-9)
    np.testing.assert_allclose(
        headings(begun), headings(list_initial_poses(whole, sparse_map, EVERY)) * 4
    )
    nothing = replace(compass, heading_sigma_deg=np.inf)
    assert headings(list_initial_poses(nothing, sparse_map, EVERY)) == headings(
        list_initial_poses(None, sparse_map, EVERY)
    )
    barometer = replace(whole, position_sigma=np.array([5.0, 5.0, np.inf]))
    assert barometer.has_position
