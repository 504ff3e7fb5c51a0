from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.retrieval import VladIndex, nearest_by_position


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
