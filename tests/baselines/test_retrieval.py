from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.retrieval import VladIndex, nearest_by_position, nearest_by_view
from scene.camera import Camera
from scene.sparse_map import MapImage, SparseMap


def unit(x: NDArray[np.float64]) -> NDArray[np.float32]:
    return (x / np.linalg.norm(x, axis=-1, keepdims=True)).astype(np.float32)


@pytest.fixture(scope="module")
def photographs() -> list[NDArray[np.float32]]:
    """Descriptors of twelve places, each with its own mixture of a few kinds of thing."""
    rng = np.random.default_rng(0)
    kinds = rng.normal(size=(30, 32))
    places = []
    for _ in range(12):
        chosen = rng.choice(30, 150, p=rng.dirichlet(np.full(30, 0.3)))
        places.append(unit(kinds[chosen] + 0.4 * rng.normal(size=(150, 32))))
    return places


def test_a_photograph_of_the_map_ranks_itself_first(
    photographs: list[NDArray[np.float32]],
) -> None:
    index = VladIndex.build(photographs)
    for k, descriptors in enumerate(photographs):
        assert index.rank(descriptors, 3)[0] == k


def test_half_a_noisy_photograph_ranks_its_place_first(
    photographs: list[NDArray[np.float32]],
) -> None:
    index = VladIndex.build(photographs)
    rng = np.random.default_rng(1)
    first = [index.rank(unit(d[:75] + 0.1 * rng.normal(size=(75, 32))), 1)[0] for d in photographs]
    assert np.mean(np.array(first) == np.arange(12)) > 0.9


def test_vectors_are_of_unit_length_and_repeatable(
    photographs: list[NDArray[np.float32]],
) -> None:
    index = VladIndex.build(photographs)
    np.testing.assert_allclose(np.linalg.norm(index.vectors, axis=1), 1, rtol=1e-5)
    np.testing.assert_array_equal(VladIndex.build(photographs).vectors, index.vectors)


def test_ranking_returns_each_row_once_and_no_more_than_there_are(
    photographs: list[NDArray[np.float32]],
) -> None:
    index = VladIndex.build(photographs)
    assert index.rank(photographs[0], 5).shape == (5,)
    assert sorted(index.rank(photographs[0], 99)) == list(range(12))


def test_blank_photographs_are_no_obstacle(photographs: list[NDArray[np.float32]]) -> None:
    blank = np.zeros((0, 32), np.float32)
    index = VladIndex.build([photographs[0], blank, photographs[1]])
    assert index.rank(photographs[1], 1)[0] == 2
    assert sorted(index.rank(blank, 3)) == [0, 1, 2]


def test_a_map_of_fewer_descriptors_than_words() -> None:
    """Every descriptor is a word of its own, so that all photographs look alike."""
    few = [unit(np.eye(4)[:2]), unit(np.eye(4)[2:])]
    index = VladIndex.build(few)
    assert np.isfinite(index.vectors).all()
    assert sorted(index.rank(few[1], 2)) == [0, 1]


def test_nearest_by_position_ignores_altitude() -> None:
    centres = np.array([[0.0, 0, 0], [10, 0, 100], [20, 0, 500], [-5, 0, 0]])
    position = np.array([14.0, 0, 0])
    assert nearest_by_position(centres, position, 3).tolist() == [1, 2, 0]
    for up in (-1e4, 1e4):
        raised = position + np.array([0, 0, up])
        assert nearest_by_position(centres, raised, 3).tolist() == [1, 2, 0]


def test_nearest_by_position_of_a_small_map() -> None:
    assert nearest_by_position(np.zeros((2, 3)), np.ones(3), 5).tolist() == [0, 1]


def test_photographs_turned_and_aimed_like_the_query_come_first() -> None:
    """Cameras 80 m over level ground: beside, turned by half a turn, and aimed ahead."""

    def looking(east: float, heading: float, tilt: float = 0.0) -> NDArray[np.float64]:
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        c, s = np.cos(tilt), np.sin(tilt)
        lean = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        pose = np.eye(4)
        pose[:3, :3] = lean @ np.diag([1.0, -1.0, -1.0]) @ turn
        pose[:3, 3] = -pose[:3, :3] @ [east, 0, 80]
        return pose

    camera = Camera("SIMPLE_PINHOLE", 100, 100, (80.0, 50.0, 50.0))
    nothing, none = np.zeros((0, 2)), np.zeros(0, np.int64)
    poses = {"a": looking(0, np.pi), "b": looking(25, 0.1), "c": looking(90, 0), "d": looking(2, 2)}
    images = {n: MapImage(n, camera, pose, nothing, none) for n, pose in poses.items()}
    ground = np.random.default_rng(0).uniform(-200, 200, (300, 3)) * [1, 1, 0]
    count = len(ground)
    sparse_map = SparseMap(
        images, ground, np.zeros((count, 3), np.uint8), np.zeros(count), np.full(count, 3)
    )
    found = nearest_by_view(sparse_map, np.array([0.0, 0, 80]), looking(0, 0)[:3, :3], 4)
    assert [sparse_map.names[row] for row in found] == ["b", "c", "d", "a"]
