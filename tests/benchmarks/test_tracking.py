"""An image of a sequence beside the same image near its prior, in one run: read the ratio.

``experiments/tracked.py`` follows a whole flight.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from experiments.pixloc_cost import CAMERA, TRUTH
from objconnect.methods import create
from objconnect.scene.localizer import Localizer, Prior, Query, Status
from tests.baselines.pixloc.made_map import looking_down, photograph, write_map

pytestmark = pytest.mark.thorough
PREDICTED = looking_down(9.15, -0.3, (1.4, -0.9, 3.7))


@pytest.fixture(scope="module")
def localizer(tmp_path_factory: pytest.TempPathFactory) -> Localizer:
    images = tmp_path_factory.mktemp("ground") / "images"
    made = create("objconnect", {})
    made.prepare(write_map(images, CAMERA), images)
    return made


@pytest.mark.benchmark(group="an image of a sequence, 512 x 512 pixels")
@pytest.mark.parametrize("way", ["tracked", "untracked"])
def test_image_of_a_sequence(benchmark: BenchmarkFixture, localizer: Localizer, way: str) -> None:
    rotation = PREDICTED.rotation.numpy()
    prior = Prior(PREDICTED.centre().numpy(), np.full(3, 0.2), rotation, 0.5)
    query = Query("query.png", photograph(TRUTH, CAMERA), CAMERA, prior)
    estimate = benchmark(localizer.localize, replace(query, tracked=way == "tracked"))
    assert estimate.status is Status.OK
    assert float(estimate.cam_from_world.error_to(TRUTH)[0]) < 0.1
