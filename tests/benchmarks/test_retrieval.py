"""Choosing photographs of maps of 100 and of 10,000: read the ratios, not the seconds.

``make bench``; the ordinary test run executes each once, to keep them working.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pytest_benchmark.fixture import BenchmarkFixture

from objconnect.localization.matching.retrieval import References, Viewpoints, VladIndex
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.localizer import Prior, Query
from objconnect.scene.maps.sparse_map import MapImage, SparseMap

pytestmark = pytest.mark.thorough

CAMERA = Camera("SIMPLE_PINHOLE", 100, 100, (80.0, 50.0, 50.0))
# Metres between photographs of a survey, points of each of them.
SPACING, POINTS = 20.0, 30
BOTH = pytest.mark.parametrize("photographs", [100, 10_000])


def survey(photographs: int) -> References:
    """A square of photographs, looking down from 80 m, with random appearances."""
    rng = np.random.default_rng(0)
    side = round(photographs**0.5)
    poses = np.tile(np.diag([1.0, -1, -1, 1]), (photographs, 1, 1))
    centres = np.full((photographs, 3), 80.0)
    centres[:, :2] = SPACING * np.stack(np.divmod(np.arange(photographs), side), 1)
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], centres)
    nothing, none = np.zeros((0, 2)), np.zeros(0, np.int64)
    images = {f"{k:06d}": MapImage("", CAMERA, pose, nothing, none) for k, pose in enumerate(poses)}
    count = photographs * POINTS
    ground = rng.uniform(0, 1, (count, 3)) * [SPACING * side, SPACING * side, 3]
    zeros = np.zeros(count)
    sparse_map = SparseMap(images, ground, np.zeros((count, 3), np.uint8), zeros, zeros.astype(int))
    words = rng.standard_normal((64, 128), np.float32)
    basis = rng.standard_normal((words.size, min(photographs, 512)), np.float32)
    vectors = rng.standard_normal((photographs, basis.shape[1]), np.float32)
    index = VladIndex(words, basis, vectors)
    return References(sparse_map.names, Viewpoints(sparse_map), index)


@pytest.fixture(scope="module")
def surveys() -> dict[int, References]:
    return {photographs: survey(photographs) for photographs in (100, 10_000)}


def make_query(attitude: NDArray[np.float64] | None) -> Query:
    position = np.array([91.0, 87.0, 80.0])
    prior = Prior(position, np.ones(3), attitude, None if attitude is None else 1.0)
    return Query("q", np.zeros((100, 100, 3), np.uint8), CAMERA, prior)


@BOTH
@pytest.mark.parametrize("tilted", [True, False])
@pytest.mark.benchmark(group="choose references by the prior")
def test_by_prior(
    benchmark: BenchmarkFixture, surveys: dict[int, References], photographs: int, tilted: bool
) -> None:
    query, references = make_query(np.diag([1.0, -1, -1])), surveys[photographs]
    references.choose(query, 5, pytest.fail, tilted)
    chosen = benchmark(references.choose, query, 5, pytest.fail, tilted)
    assert len(chosen) == 5


@BOTH
@pytest.mark.benchmark(group="choose references by appearance")
def test_by_appearance(
    benchmark: BenchmarkFixture, surveys: dict[int, References], photographs: int
) -> None:
    descriptors = np.random.default_rng(1).standard_normal((2000, 128), np.float32)
    index = surveys[photographs].index
    assert len(benchmark(index.rank, descriptors, 5)) == 5
