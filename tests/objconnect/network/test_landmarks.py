"""Objects of a map: seen in several photographs, they are one landmark where they are one thing."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from objconnect.localization.coarse.grid import GroundGrid
from objconnect.network.detector import Detections
from objconnect.network.landmarks import Landmarks, View, merge, place_on_ground
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose, so3_exp

CAMERA = Camera("PINHOLE", 400, 400, (400.0, 400.0, 200.0, 200.0))
GROUND = GroundGrid(np.array([-200.0, -200.0]), 10.0, np.full((40, 40), 5.0))
DOWN = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))


def things(seed: int = 0, count: int = 40) -> tuple[NDArray[np.float64], torch.Tensor]:
    """Centres of things on the ground, and a vector of each."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-60, 60, (count, 2))
    rise = rng.uniform(0.3, 4.0, count)
    vectors = torch.nn.functional.normalize(torch.from_numpy(rng.normal(size=(count, 8))), dim=1)
    return np.column_stack([xy, 5.0 + rise]), vectors.float()


def photograph(
    centre: tuple[float, float, float],
    turn: tuple[float, float, float],
    xyz: NDArray[np.float64],
    vectors: torch.Tensor,
) -> View:
    """What a photograph shows of things, each of 2 m."""
    rotation = so3_exp(torch.tensor(turn, dtype=torch.float64)) @ DOWN
    pose = Pose(rotation, -rotation @ torch.tensor(centre, dtype=torch.float64))
    in_camera = pose.transform(torch.from_numpy(xyz))
    projected = CAMERA.project(in_camera)
    shown = projected.valid & CAMERA.contains(projected.xy)
    per_metre = 400.0 / in_camera[:, 2]
    found = Detections(
        projected.xy[shown].float(),
        torch.full((int(shown.sum()),), 0.9),
        (2.0 * per_metre)[shown].float(),
        (torch.from_numpy(xyz[:, 2] - 5.0) * per_metre)[shown].float(),
        vectors[shown],
    )
    return View(f"{centre}.jpg", CAMERA, pose, found, place_on_ground(found, CAMERA, pose, GROUND))


def views(xyz: NDArray[np.float64], vectors: torch.Tensor) -> list[View]:
    turns = [(0.0, 0.0, 0.3), (0.15, 0.0, 2.0), (0.0, -0.2, -1.0), (0.1, 0.1, 0.0)]
    places = [(0.0, 0.0, 85.0), (20.0, 10.0, 95.0), (-15.0, 20.0, 80.0), (10.0, -25.0, 90.0)]
    return [photograph(c, t, xyz, vectors) for c, t in zip(places, turns, strict=True)]


def test_things_are_placed_where_they_are() -> None:
    xyz, vectors = things()
    for view in views(xyz, vectors):
        away = np.linalg.norm(view.placed_objects.xyz[:, None] - xyz, axis=-1).min(1)
        assert away.max() < 0.01
        np.testing.assert_allclose(view.placed_objects.sides, 2.0, atol=0.01)


def test_a_ray_to_the_sky_has_no_place() -> None:
    xyz, vectors = things()
    view = photograph((0.0, 0.0, 85.0), (0.0, 0.0, 0.0), xyz, vectors)
    flat = Pose(so3_exp(torch.tensor([np.pi / 2, 0.0, 0.0])).double(), torch.zeros(3).double())
    placed = place_on_ground(view.detections, CAMERA, flat, GROUND)
    assert np.isnan(placed.xyz).all(1).any()
    assert len(merge([view._replace(placed_objects=placed, pose=flat)])[0]) <= len(placed.xyz)


def test_one_thing_in_several_photographs_is_one_landmark() -> None:
    xyz, vectors = things()
    landmarks = merge(views(xyz, vectors))[0]
    away = np.linalg.norm(landmarks.xyz[:, None] - xyz, axis=-1)
    assert away.min(1).max() < 0.05
    nearest = away.argmin(1)
    assert len(set(nearest.tolist())) == len(landmarks) >= 30
    np.testing.assert_allclose(landmarks.vectors, vectors[nearest].numpy(), atol=1e-5)
    assert landmarks.views.max() == 4


def test_what_one_photograph_of_four_shows_is_none() -> None:
    xyz, vectors = things()
    seen = views(xyz, vectors)
    ghost = np.array([[1.0, 2.0, 6.0]])
    alone = photograph((0.0, 0.0, 85.0), (0.0, 0.0, 0.3), ghost, torch.eye(8)[:1])
    both = seen[0].detections, alone.detections
    joined = Detections(
        *(torch.cat([getattr(each, name) for each in both]) for name in vars(both[0]))
    )
    placed = place_on_ground(joined, CAMERA, seen[0].pose, GROUND)
    landmarks = merge([seen[0]._replace(detections=joined, placed_objects=placed), *seen[1:]])[0]
    assert np.linalg.norm(landmarks.xyz - ghost, axis=1).min() > 0.2


def test_neighbours_that_look_different_stay_apart() -> None:
    xyz = np.array([[0.0, 0.0, 6.0], [0.6, 0.0, 6.0]])
    apart, alike = torch.eye(8)[:2], torch.eye(8)[[0, 0]]
    assert len(merge(views(xyz, apart))[0]) == 2
    assert len(merge(views(xyz, alike))[0]) == 1


def test_no_objects_are_no_landmarks() -> None:
    empty = merge(views(np.zeros((0, 3)), torch.zeros(0, 8)))[0]
    assert len(empty) == 0
    assert len(merge([])[0]) == 0


def test_landmarks_come_back_from_their_arrays() -> None:
    landmarks = merge(views(*things()))[0]
    again = Landmarks.of(landmarks.arrays())
    np.testing.assert_array_equal(again.xyz, landmarks.xyz)
    np.testing.assert_allclose(again.vectors, landmarks.vectors, atol=1e-3)
    np.testing.assert_array_equal(again.views, landmarks.views)
    with pytest.raises(ValueError, match="different lengths"):
        Landmarks.of(landmarks.arrays() | {"xyz": landmarks.xyz[1:]})
