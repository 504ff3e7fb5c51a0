"""A pose from matched objects: its tilt is corrected, and kept where nothing tells it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from objconnect.network.object_pose import refine_pose
from objconnect.scene.geometry.pose import Pose, so3_exp
from tests.objconnect.network.test_landmarks import DOWN


def place(count: int) -> tuple[Pose, NDArray[np.float64], NDArray[np.float64]]:
    """A tilted camera 60 m above objects, their rays and their positions."""
    random = np.random.default_rng(0)
    xyz = np.column_stack([random.uniform(-40, 40, (count, 2)), random.uniform(0, 8, count)])
    rotation = so3_exp(torch.tensor([-0.4, 0.05, 0.0]).double()) @ DOWN
    pose = Pose(rotation, -rotation @ torch.tensor([3.0, -25.0, 60.0], dtype=torch.float64))
    seen = pose.transform(torch.from_numpy(xyz)).numpy()
    return pose, seen[:, :2] / seen[:, 2:], xyz


def off(pose: Pose) -> Pose:
    rotation = so3_exp(torch.tensor([0.09, -0.03, 0.05]).double()) @ pose.rotation
    return Pose(rotation, -rotation @ (pose.centre() + torch.tensor([3.0, 4.0, -2.0])))


def test_the_tilt_is_that_at_which_objects_agree() -> None:
    pose, rays, xyz = place(60)
    metres, degrees = off(pose).error_to(pose)
    assert float(metres) > 5 and float(degrees) > 5
    metres, degrees = refine_pose(off(pose), rays, xyz, np.ones(60)).error_to(pose)
    assert float(metres) < 1.5 and float(degrees) < 1.5


def test_matches_without_weight_change_nothing() -> None:
    pose, rays, xyz = place(60)
    weights = np.where(np.arange(60) < 5, 1.0, 0.0)
    begin = off(pose)
    assert refine_pose(begin, rays, xyz, weights) is begin
    assert refine_pose(begin, rays, xyz, np.zeros(60)) is begin
    strange = np.where(weights[:, None] > 0, rays, 1e3)
    kept = np.where(np.arange(60) < 30, 1.0, 0.0)
    mixed = np.where(kept[:, None] > 0, rays, strange)
    metres, _ = refine_pose(begin, mixed, xyz, kept).error_to(pose)
    assert float(metres) < 2.5


@pytest.mark.parametrize("count", [6, 20])
def test_objects_on_a_line_or_behind_give_a_finite_pose(count: int) -> None:
    pose, rays, xyz = place(count)
    line = xyz * [1.0, 0.0, 0.0]
    for there in (line, xyz + np.array([0.0, 0.0, 100.0]), np.zeros_like(xyz)):
        found = refine_pose(off(pose), rays, there, np.ones(count))
        assert bool(torch.isfinite(found.matrix()).all())
