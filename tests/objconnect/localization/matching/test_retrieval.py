from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from objconnect.localization.matching.retrieval import (
    References,
    Viewpoints,
    VladIndex,
)
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.localizer import Prior, Query
from objconnect.scene.maps.sparse_map import MapImage, SparseMap


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


def test_a_map_of_more_photographs_than_landmarks(photographs: list[NDArray[np.float32]]) -> None:
    """Fewer numbers a photograph, which is still found again by half of it."""
    index = VladIndex.build(photographs, spanning=8)
    assert index.vectors.shape == (12, 8)
    found = [int(index.rank(each[:75], 1)[0]) for each in photographs]
    assert np.mean(np.array(found) == np.arange(12)) > 0.7


CAMERA = Camera("SIMPLE_PINHOLE", 100, 100, (80.0, 50.0, 50.0))


def map_of(poses: dict[str, NDArray[np.float64]], ground: NDArray[np.float64]) -> SparseMap:
    nothing, none = np.zeros((0, 2)), np.zeros(0, np.int64)
    images = {n: MapImage(n, CAMERA, pose, nothing, none) for n, pose in poses.items()}
    count = len(ground)
    return SparseMap(
        images, ground, np.zeros((count, 3), np.uint8), np.zeros(count), np.full(count, 3)
    )


def cameras_at(centres: NDArray[np.float64]) -> SparseMap:
    poses = np.tile(np.eye(4), (len(centres), 1, 1))
    poses[:, :3, 3] = -centres
    return map_of({f"{k:06d}": pose for k, pose in enumerate(poses)}, np.zeros((0, 3)))


def test_near_ignores_altitude() -> None:
    viewpoints = Viewpoints(cameras_at(np.array([[0.0, 0, 0], [10, 0, 100], [20, 0, 500]])))
    position = np.array([14.0, 0, 0])
    assert viewpoints.nearest(position, 3).tolist() == [1, 2, 0]
    for up in (-1e4, 1e4):
        assert viewpoints.nearest(position + np.array([0, 0, up]), 3).tolist() == [1, 2, 0]


@pytest.mark.parametrize(
    ("sigma", "expected"), [(None, [0, 1]), (5.0, [0, 1]), (30.0, [3, 4]), (1e6, [9, 3])]
)
def test_an_unsure_position_leaves_what_looks_alike(
    photographs: list[NDArray[np.float32]], sigma: float | None, expected: list[int]
) -> None:
    """Twelve photographs in a row, 10 m apart; the query looks like the tenth, and a little like
    the fourth and fifth."""
    sparse_map = cameras_at(np.arange(12)[:, None] * np.array([10.0, 0, 0]))
    described = [photographs[k] for k in range(12)]
    described[4] = np.concatenate([photographs[9][:20], photographs[4][:50]])
    described[3] = np.concatenate([photographs[9][:60], photographs[3][:50]])
    references = References.build(sparse_map, described)
    prior = Prior(np.zeros(3), None if sigma is None else np.full(3, sigma))
    query = Query("q", np.zeros((100, 100, 3), np.uint8), CAMERA, prior)
    assert references.choose(query, 2, lambda: photographs[9]).tolist() == expected
    blank = np.zeros((0, 32), np.float32)
    assert references.choose(query, 2, lambda: blank).tolist() == [0, 1]


def test_near_in_a_small_map() -> None:
    assert Viewpoints(cameras_at(np.zeros((2, 3)))).nearest(np.ones(3), 5).tolist() == [0, 1]


def test_words_are_found_in_some_of_many_descriptors(
    photographs: list[NDArray[np.float32]],
) -> None:
    many = [np.concatenate([p] * (90_000 // sum(map(len, photographs)))) for p in photographs]
    index = VladIndex.build(many)
    assert [int(index.rank(each, 1)[0]) for each in photographs] == list(range(len(photographs)))


def test_photographs_that_show_the_same_north_up_come_first() -> None:
    """Cameras 80 m over level ground: turned by half a turn, beside, and aimed ahead."""

    def looking(east: float, heading: float, tilt: float = 0.0) -> NDArray[np.float64]:
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        c, s = np.cos(tilt), np.sin(tilt)
        lean = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        pose = np.eye(4)
        pose[:3, :3] = lean @ np.diag([1.0, -1.0, -1.0]) @ turn
        pose[:3, 3] = -pose[:3, :3] @ [east, 0, 80]
        return pose

    poses = {"a": looking(0, np.pi), "b": looking(25, 0.1), "c": looking(90, 0), "d": looking(2, 2)}
    poses["0"] = looking(0, 0, 1.0)
    ground = np.random.default_rng(0).uniform(-200, 200, (300, 3)) * [1, 1, 0]
    sparse_map = map_of(poses, ground)
    viewpoints = Viewpoints(sparse_map)
    found = viewpoints.most_similar(np.array([0.0, 0, 80]), looking(0, 0)[:3, :3], 5)
    assert [sparse_map.names[row] for row in found] == ["a", "d", "b", "c", "0"]
