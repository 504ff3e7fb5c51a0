"""pixloc and objconnect beside the code of PixLoc's authors: see ``pixloc_cost``, which also says
what they take of memory.

``OBJCONNECT_PIXLOC`` names a checkout of github.com/cvg/pixloc. Without it ours stand beside a
lower bound of what that code does for every query.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from experiments.pixloc_cost import CAMERA, METHODS, Ground, lower_bound, make
from objconnect.scene.geometry.camera import Camera
from tests.baselines.pixloc import official

pytestmark = pytest.mark.thorough


# Where nothing is measured, a quarter of the pixels shows that the queries run.
SMALL = Camera("PINHOLE", 256, 256, (220.0, 220.0, 128.0, 128.0))


@pytest.fixture(scope="module")
def ground(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Ground:
    camera = SMALL if request.config.getoption("benchmark_disable") else CAMERA
    return Ground.write(tmp_path_factory.mktemp("pixloc"), camera)


@pytest.mark.benchmark(group="one query of 512 x 512 pixels")
@pytest.mark.parametrize("method", METHODS)
def test_one_query(benchmark: BenchmarkFixture, ground: Ground, method: str) -> None:
    checkout = os.environ.get("OBJCONNECT_PIXLOC")
    if checkout:
        official.load(Path(checkout))
    benchmark(lower_bound(ground) if method == "authors" and not checkout else make(method, ground))
