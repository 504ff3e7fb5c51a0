from __future__ import annotations

import numpy as np
import pytest

from scene.camera import Camera
from scene.covisibility import overlap_matrix, surface_points

# Sees 40 x 30 m of flat ground from 40 m.
CAMERA = Camera("PINHOLE", 80, 60, (80.0, 80.0, 40.0, 30.0))


def looking_down(east: float) -> np.ndarray:
    cam_from_world = np.diag([1.0, -1.0, -1.0, 1.0])
    cam_from_world[:3, 3] = -cam_from_world[:3, :3] @ [east, 0.0, 40.0]
    return cam_from_world


def test_surface_points_lie_on_the_ground_in_view() -> None:
    depth = np.full((60, 80), 40.0, np.float32)
    depth[:30] = 0  # the upper half is sky
    points = surface_points(CAMERA, looking_down(5.0), depth, per_side=4)
    seen = np.isfinite(points).all(1)
    assert seen.sum() == 8
    np.testing.assert_allclose(points[seen][:, 2], 0, atol=1e-9)
    assert np.abs(points[seen][:, 0] - 5).max() < 20
    assert (points[seen][:, 1] < 0).all()


def test_overlap_of_a_strip_of_flat_ground() -> None:
    poses = np.stack([looking_down(east) for east in (0.0, 10.0, 100.0)])
    depth = np.full((60, 80), 40.0, np.float32)
    points = np.stack([surface_points(CAMERA, pose, depth, 16) for pose in poses])
    shares = overlap_matrix([CAMERA] * 3, poses, points)
    assert shares[0, 1] == pytest.approx(0.75, abs=0.07)
    assert shares[0, 2] == shares[1, 2] == 0
    np.testing.assert_array_equal(shares, shares.T)
    np.testing.assert_array_equal(np.diag(shares), 0)


def test_a_picture_of_nothing_overlaps_nothing() -> None:
    poses = np.stack([looking_down(0.0)] * 2)
    points = np.full((2, 4, 3), np.nan)
    np.testing.assert_array_equal(overlap_matrix([CAMERA] * 2, poses, points), 0)
