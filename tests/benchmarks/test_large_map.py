"""A whole query in maps of 100 and of 1,000 photographs: read the ratio, not the seconds.

``make bench``; of 10,000 and of memory tells ``python -m experiments.large_map``.
"""

from __future__ import annotations

from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from experiments.large_map import Flight, fly, ground, localizer_of, queries, write_map
from objconnect.localization.matching.structure import StructureLocalizer
from objconnect.scene.localizer import Status
from objconnect.scene.storage.lru_cache import MEGABYTE

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def flight() -> Flight:
    return fly(ground())


@pytest.mark.parametrize("photographs", [100, 1000])
@pytest.mark.benchmark(group="localize by sift with a prior")
def test_query(
    benchmark: BenchmarkFixture, flight: Flight, tmp_path: Path, photographs: int
) -> None:
    """Less of the map is in memory than the queries need."""
    write_map(tmp_path, flight, photographs // 100)
    localizer = localizer_of(tmp_path, flight, "sift", {"memory_mb": "2"})
    assert isinstance(localizer, StructureLocalizer)
    asked = queries(ground(), photographs // 100, 20)
    for query in asked:
        estimate = localizer.localize(query)
        assert estimate.status is Status.OK, estimate.reason
        assert estimate.cam_from_world is not None
        assert query.prior is not None
        # The prior is a metre off.
        truth = query.prior.position - np.array([1, 0, 0])
        assert abs(estimate.cam_from_world.centre().numpy() - truth).max() < 0.5
        assert localizer._lifted_keypoints.nbytes <= 2 * MEGABYTE
    again = cycle(asked)
    benchmark(lambda: localizer.localize(next(again)))
