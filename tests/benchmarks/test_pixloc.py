"""pixloc beside its authors' code, with the same weights, photographs, points and start.

``OBJCONNECT_PIXLOC`` names a checkout of github.com/cvg/pixloc (commit 65a51a7; omegaconf and tqdm
must be importable). Without it ours stands beside a lower bound of what that code does for every
query before it aligns anything: the network, in float32 and contiguous, on the query and on three
references.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image
from pytest_benchmark.fixture import BenchmarkFixture

from baselines.pixloc.localizer import PixlocConfig, PixlocLocalizer
from baselines.weights import write_weights
from scene.localizer import Prior, Query
from scene.sparse_map import SparseMap
from tests.baselines.pixloc import official
from tests.baselines.pixloc.made_map import CAMERA, looking_down, photograph, write_map

SIZED = CAMERA.resized(384, 288)
START = looking_down(8.9, -0.1, (0.5, 0.0, 3.0))
ITERATIONS = 100
GROUP = "pixloc, one query of 384 x 288 pixels, 512 points"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pixloc")


@pytest.fixture(scope="module")
def sparse_map(folder: Path) -> SparseMap:
    return write_map(folder / "images", SIZED)


@pytest.fixture(scope="module")
def query(folder: Path) -> Query:
    image = photograph(looking_down(9.3, -0.4, (1.5, -1.0, 4.0)), SIZED)
    Image.fromarray(image).save(folder / "images/query.png")
    prior = Prior(START.centre().numpy(), None, START.rotation.numpy(), None)
    return Query("query.png", image, SIZED, prior)


@pytest.fixture(scope="module")
def localizer(folder: Path, sparse_map: SparseMap) -> PixlocLocalizer:
    path, network = folder / "pixloc.safetensors", official.ours()
    write_weights(path, network, network.config.model_dump())
    localizer = PixlocLocalizer(
        PixlocConfig(weights=path, iterations=ITERATIONS, references=3, points=512)
    )
    localizer.prepare(sparse_map, folder / "images", folder)
    return localizer


@pytest.mark.benchmark(group=GROUP)
def test_ours(benchmark: BenchmarkFixture, localizer: PixlocLocalizer, query: Query) -> None:
    assert benchmark(localizer.localize, query).iterations > 0


@pytest.mark.benchmark(group=GROUP)
def test_peer(
    benchmark: BenchmarkFixture,
    localizer: PixlocLocalizer,
    sparse_map: SparseMap,
    query: Query,
    folder: Path,
) -> None:
    checkout = os.environ.get("OBJCONNECT_PIXLOC")
    if checkout:
        official.load(Path(checkout))
        run = _authors(localizer, sparse_map, query, folder)
    else:
        run = _lower_bound(localizer, query)
    assert np.isfinite(benchmark(run)).all()


def _authors(
    localizer: PixlocLocalizer, sparse_map: SparseMap, query: Query, folder: Path
) -> Callable[[], object]:
    """What ``run_CMU.py`` does with a query, its references chosen."""
    from pixloc.localization import (  # type: ignore[import-not-found]
        Model3D,
        PoseRefiner,
    )
    from pixloc.localization.feature_extractor import (  # type: ignore[import-not-found]
        FeatureExtractor,
    )
    from pixloc.pixlib.geometry import Camera, Pose  # type: ignore[import-not-found]
    from pixloc.utils.colmap import Image as View  # type: ignore[import-not-found]

    camera = {"model": SIZED.model, "params": np.array(SIZED.params)}
    camera |= {"width": SIZED.width, "height": SIZED.height}
    model = Model3D.__new__(Model3D)
    model.cameras, model.dbs = {1: camera}, {}
    for number, name in enumerate(sparse_map.names):
        image = sparse_map.images[name]
        quaternion, t = image.pose.quaternion().numpy(), image.pose.translation.numpy()
        model.dbs[number] = View(number, quaternion, t, 1, name, image.xy, image.point_rows)
    model.points3D = {row: SimpleNamespace(xyz=xyz) for row, xyz in enumerate(sparse_map.xyz)}

    refiner = official.refiner(
        num_iters=ITERATIONS, pad=2, dt_stop_criteria=5e-3, grad_stop_criteria=1e-4
    )
    cpu = torch.device("cpu")
    optimizers = list(refiner.optimizer)
    extractor = FeatureExtractor(refiner.extractor, cpu, {})
    paths = SimpleNamespace(reference_images=folder / "images", query_images=folder / "images")
    peer = PoseRefiner(cpu, optimizers, model, extractor, paths, {})
    # The points that ours are, each of the photographs it is taken from.
    chosen = [sparse_map.names.index(name) for name in ("0.png", "1.png", "2.png")]
    seen: dict[int, set[int]] = {}
    for number in chosen:
        for row in localizer._observations[number].rows[: localizer.config.points // 3]:
            seen.setdefault(int(row), set()).add(number)
    start = Pose.from_Rt(START.rotation.numpy(), START.translation.numpy())
    theirs = Camera.from_colmap(camera)

    @torch.no_grad()
    def run() -> object:
        answer = peer.refine_query_pose(query.name, theirs, start, seen)
        assert answer["success"]
        return answer["T_refined"].numpy()[1]

    return run


def _lower_bound(localizer: PixlocLocalizer, query: Query) -> Callable[[], object]:
    network = official.ours().to(memory_format=torch.contiguous_format)
    image = torch.from_numpy(query.image).permute(2, 0, 1)[None].float().contiguous() / 255

    @torch.inference_mode()
    def run() -> object:
        for _ in range(1 + localizer.config.references):
            levels = network(image)
        return levels[0][0].numpy()

    return run
