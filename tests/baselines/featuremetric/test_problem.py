from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from baselines.align.options import Options
from baselines.featuremetric.maps import MapExtractor
from baselines.featuremetric.problem import ProblemBuilder
from baselines.featuremetric.references import ReferenceSource, references
from baselines.pixloc.network import read_network
from scene.localizer import Query
from tests.baselines.pixloc.made_map import (
    CAMERA,
    looking_down,
    photograph,
    write_map,
    write_network,
)


def test_points_cover_the_image_although_references_overlap_in_its_middle(tmp_path: Path) -> None:
    network = read_network(write_network(tmp_path / "pixloc.safetensors"))[0]
    extract = MapExtractor(network, 1024, "float32")
    images = tmp_path / "images"
    observations = references(
        ReferenceSource(write_map(images), images, extract, "key", "pixloc", 2000), tmp_path, 2**20
    )
    damping = [factors().detach() for factors in network.damping]
    problems = ProblemBuilder(extract, observations, damping, Options())
    start = looking_down(12.0, 0.0)  # above the middle one of five
    chosen = np.arange(5)
    with torch.inference_mode():
        looked = problems.view(Query("q", photograph(start), CAMERA), chosen, start)
        problem = problems.build(*looked, chosen, start, 200)
    view = looked[0]
    xy = view.camera.project(view.pose(start).transform(problem.points[0])).xy
    column = (xy[:, 0] / view.camera.width * 4).long()
    counts = column.bincount(minlength=4)
    assert counts.sum() == 200
    assert counts.max() < 1.3 * counts.min()
