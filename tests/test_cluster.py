"""A cluster that loses a node gives the scene, map, results and depth of a single machine."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate
from benchmark.results.query_result import QueryResult
from benchmark.results.results import Results
from benchmark.results.results_files import load
from objconnect.mapping.build import build_map
from objconnect.mapping.dense.command import dense
from objconnect.methods import create
from objconnect.scene.bundle.scene import Scene
from simulate.command import simulate
from simulate.config import SimulateConfig
from tests.two_nodes import TwoNodes

pytestmark = pytest.mark.thorough

TINY = SimulateConfig.model_validate(
    {
        "seed": 5,
        "area": 120,
        "size": 96,
        "spp": 1,
        "sensor": {"full_well_e": 8000, "read_noise_e": 6},
        "sessions": [
            {"condition": "summer-noon", "flight": "nadir", "role": "map", "frames": 6},
        ],
    }
)


def without_seconds(results: Results) -> tuple[QueryResult, ...]:
    return tuple(query.model_copy(update={"seconds": {}}) for query in results.queries)


def test_a_cluster_renders_the_same_scene(two_nodes: TwoNodes, tmp_path: Path) -> None:
    alone = simulate(TINY, tmp_path / "alone")
    out = tmp_path / "cluster"
    with two_nodes.killed_at_work(when=lambda: any(out.rglob("0*.npz"))):
        spread = simulate(TINY, out, cluster=two_nodes.address)
    assert spread.manifest.sha256 == alone.manifest.sha256
    assert spread.manifest.pixels_sha256 == alone.manifest.pixels_sha256
    assert spread.find_changed_files() == []
    assert not list(out.rglob(".*")), "nothing of the rendering is left behind"


def test_a_cluster_builds_the_same_map(
    two_nodes: TwoNodes, rendered: Scene, rendered_copy: Path
) -> None:
    shutil.rmtree(rendered_copy / "map")
    with two_nodes.killed_at_work():
        build_map(rendered_copy, cluster=two_nodes.address)
    assert Scene.open(rendered_copy).manifest.sha256 == rendered.manifest.sha256


@pytest.mark.parametrize("method", ["sift", pytest.param("objconnect", marks=pytest.mark.slow)])
def test_a_cluster_gives_the_same_results(
    two_nodes: TwoNodes, rendered: Scene, tmp_path: Path, method: str
) -> None:
    # One thread, as on a cluster's core: several add in another order.
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    command = [sys.executable, "-m", "benchmark.cli", "evaluate", str(rendered.path)]
    command += ["--method", method, "--out", str(tmp_path / "alone")]
    subprocess.run(command, env=os.environ | threads, check=True, capture_output=True)
    (dataset,) = open_datasets(rendered.path)
    alone = load(tmp_path / "alone" / dataset.name / f"{method}.json")
    with two_nodes.killed_at_work():
        spread = evaluate(
            dataset,
            create(method, {}),
            tmp_path / "spread",
            cache=tmp_path / "cache",
            cluster=two_nodes.address,
        )
    assert without_seconds(spread) == without_seconds(alone)
    assert spread.summary.recall == alone.summary.recall
    assert spread.summary.peak_memory_mb is not None


def test_a_cluster_computes_the_same_depth_maps(
    two_nodes: TwoNodes, rendered: Scene, tmp_path: Path
) -> None:
    scenes = [Path(shutil.copytree(rendered.path, tmp_path / name)) for name in ("one", "two")]
    dense(scenes[0], size=64)
    with two_nodes.killed_at_work():
        report = dense(scenes[1], size=64, cluster=two_nodes.address)
    assert report.cpu_seconds_per_map is not None
    digests = [Scene.open(scene).manifest.sha256 for scene in scenes]
    assert digests[0] == digests[1]
    assert any(name.startswith("dense/") for name in digests[0])
