"""Cost of a query of pixloc, objconnect and the code of PixLoc's authors: seconds and memory.

``python -m experiments.pixloc_cost [--checkout CHECKOUT] [--scene SCENE --queries 8]`` runs each in
its own processes, with one thread and with two, on the same photographs, cameras and starts: over
artificial ground 20 m below, or for queries of a scene under other conditions than the map, with
starts wrong by 3 m and 5 degrees. CHECKOUT is github.com/cvg/pixloc at commit 65a51a7; omegaconf
and tqdm must be importable. The methods:

- pixloc, objconnect: as shipped, with defaults;
- full: pixloc with the authors' network at full width (untrained) and their number of iterations;
- authors: their code with the same weights and the same number of observations of points.

Seconds include the whole query, and not the preparation of the map.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from time import perf_counter, process_time
from types import SimpleNamespace
from typing import Final

import numpy as np
import torch
from PIL import Image

from baselines.pixloc.localizer import PixlocConfig, PixlocLocalizer
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import move_prior
from objconnect.learning.checkpoint import write_weights
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.featuremetric.references import MAX_POINTS
from objconnect.network.localizer import ObjConnectConfig, ObjConnectLocalizer
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Prior, Query, Status
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.memory import peak_megabytes, reset_peak
from objconnect.scene.runtime.tuning import ProcessTuning
from tests.baselines.pixloc import official
from tests.baselines.pixloc.made_map import looking_down, photograph, write_map

CAMERA: Final = Camera("PINHOLE", 512, 512, (440.0, 440.0, 256.0, 256.0))
TRUTH: Final = looking_down(9.3, -0.4, (1.5, -1.0, 4.0))
START: Final = looking_down(8.9, -0.1, (0.5, 0.0, 3.0))
METHODS: Final = ("pixloc", "objconnect", "full", "authors")
# Iterations of the authors' alignment, and measured runs over all queries.
_ITERATIONS: Final = 100
_RUNS: Final = 2

Run = Callable[[], object]


@dataclass(frozen=True)
class Ground:
    """A map, and queries over it.

    Attributes:
        images: folder of all photographs.
        sparse_map: the map.
        queries: queries with position and attitude.
        cache: cache folder of the methods.
    """

    images: Path
    sparse_map: SparseMap
    queries: tuple[Query, ...]
    cache: Path

    @staticmethod
    def write(folder: Path, camera: Camera = CAMERA) -> Ground:
        """Return smooth ground, and write its photographs to a folder."""
        images = folder / "images"
        sparse_map = write_map(images, camera)
        image = photograph(TRUTH, camera)
        Image.fromarray(image).save(images / "query.png")
        prior = Prior(START.centre().numpy(), None, START.rotation.numpy(), None)
        return Ground(images, sparse_map, (Query("query.png", image, camera, prior),), folder)

    @staticmethod
    def of_scene(scene: Path, count: int, cache: Path) -> Ground:
        """Return queries of other conditions than the map's, evenly spread over their list.

        The map keeps the ten photographs nearest to each query, because methods use no others.
        """
        dataset = open_datasets(scene)[0]
        others = [q for q in dataset.queries if q.condition not in dataset.map_conditions]
        chosen = [others[k] for k in np.linspace(0, len(others) - 1, count).astype(int)]
        priors = [move_prior(q.reference, q.name, 3.0, 5.0) for q in chosen]
        queries = tuple(q.load(prior) for q, prior in zip(chosen, priors, strict=True))
        whole = Ground(dataset.images, dataset.load_map(), queries, cache)
        nearest = {name for query in queries for name in whole.nearest(query, 10)}
        images = {name: whole.sparse_map.images[name] for name in sorted(nearest)}
        return replace(whole, sparse_map=replace(whole.sparse_map, images=images))

    def nearest(self, query: Query, count: int) -> list[str]:
        """Return the photographs nearest to the start of a query."""
        centre = start_of(query).centre()

        def distance(name: str) -> float:
            return float((self.sparse_map.images[name].pose.centre() - centre).norm())

        return sorted(self.sparse_map.images, key=distance)[:count]

    def references(self, query: Query) -> list[str]:
        """Return the nearest photographs, as many as a query of pixloc uses."""
        return self.nearest(query, PixlocConfig().references)


def start_of(query: Query) -> Pose:
    """Return the initial pose of the methods."""
    prior = query.prior
    assert prior is not None and prior.cam_from_world_rotation is not None
    rotation = torch.from_numpy(prior.cam_from_world_rotation)
    return Pose(rotation, -rotation @ torch.from_numpy(prior.position))


def make(method: str, ground: Ground) -> Run:
    """Return a function that localizes every query once with a method."""
    if method == "authors":
        return _authors(ground)
    localizer: FeaturemetricLocalizer
    if method == "pixloc":
        localizer = PixlocLocalizer(PixlocConfig())
    elif method == "objconnect":
        localizer = ObjConnectLocalizer(ObjConnectConfig())
    else:
        path, network = ground.cache / "full.safetensors", official.ours()
        write_weights(path, network, network.config.model_dump())
        localizer = PixlocLocalizer(PixlocConfig(weights=path))
    localizer.prepare(ground.sparse_map, ground.images, ground.cache)

    def run() -> object:
        estimates = [localizer.localize(query) for query in ground.queries]
        assert all(each.status is not Status.FAILED and each.iterations > 0 for each in estimates)
        return estimates

    return run


def lower_bound(ground: Ground) -> Run:
    """Return a function that runs the network alone, in float32 and contiguous.

    It runs on each query and its reference images, as the authors' code does before it aligns.
    """
    network = official.ours().to(memory_format=torch.contiguous_format)

    @torch.inference_mode()
    def run() -> object:
        for query in ground.queries:
            image = torch.from_numpy(query.image).permute(2, 0, 1)[None].float().contiguous() / 255
            for _ in range(1 + len(ground.references(query))):
                network(image)
        return None

    return run


def _authors(ground: Ground) -> Run:
    """Return a function that runs ``run_CMU.py`` on queries with chosen reference images."""
    from pixloc.localization import (  # type: ignore[import-not-found]
        Model3D,
        PoseRefiner,
    )
    from pixloc.localization.feature_extractor import (  # type: ignore[import-not-found]
        FeatureExtractor,
    )
    from pixloc.pixlib.geometry import Camera as Lens  # type: ignore[import-not-found]
    from pixloc.pixlib.geometry import Pose as Stance
    from pixloc.utils.colmap import Image as View  # type: ignore[import-not-found]

    query_camera = ground.queries[0].camera
    camera = {"model": query_camera.model, "params": np.array(query_camera.params)}
    camera |= {"width": query_camera.width, "height": query_camera.height}
    model = Model3D.__new__(Model3D)
    model.cameras, model.dbs = {1: camera}, {}
    sparse_map = ground.sparse_map
    numbers = {name: number for number, name in enumerate(sparse_map.images)}
    for name, number in numbers.items():
        image = sparse_map.images[name]
        quaternion, t = image.pose.quaternion().numpy(), image.pose.translation.numpy()
        model.dbs[number] = View(number, quaternion, t, 1, name, image.xy, image.point_rows)

    def choose_points(query: Query) -> dict[int, set[int]]:
        """Return the reference images that show each chosen point, by row of the point."""
        references_of: dict[int, set[int]] = {}
        references = ground.references(query)
        for name in references:
            rows = sparse_map.images[name].point_rows
            order = np.random.default_rng(0).permutation(rows[rows >= 0])
            for row in order[: MAX_POINTS // len(references)]:
                references_of.setdefault(int(row), set()).add(numbers[name])
        return references_of

    model.points3D = {row: SimpleNamespace(xyz=xyz) for row, xyz in enumerate(sparse_map.xyz)}

    refiner = official.refiner(
        num_iters=_ITERATIONS, pad=2, dt_stop_criteria=5e-3, grad_stop_criteria=1e-4
    )
    cpu = torch.device("cpu")
    extractor = FeatureExtractor(refiner.extractor, cpu, {})
    paths = SimpleNamespace(reference_images=ground.images, query_images=ground.images)
    peer = PoseRefiner(cpu, list(refiner.optimizer), model, extractor, paths, {})
    lens = Lens.from_colmap(camera)
    inputs = []
    for query in ground.queries:
        start = start_of(query)
        stance = Stance.from_Rt(start.rotation.numpy(), start.translation.numpy())
        inputs.append((query.name, lens, stance, choose_points(query)))

    @torch.no_grad()
    def run() -> object:
        answers = [peer.refine_query_pose(*each) for each in inputs]
        assert all(answer["success"] for answer in answers)
        return answers

    return run


def _measure(args: argparse.Namespace) -> None:
    """Print seconds per query and megabytes of a method as a line of JSON, in its own process."""
    torch.set_num_threads(args.threads)
    if args.checkout:
        official.load(args.checkout)
    kept = args.kept
    scene = args.scene
    ground = Ground.of_scene(scene, args.queries, kept) if scene else Ground.write(kept)
    run = make(args.one, ground)
    reset_peak()
    run()
    processor, wall = process_time(), perf_counter()
    for _ in range(_RUNS):
        run()
    count = _RUNS * len(ground.queries)
    spent = (process_time() - processor) / count, (perf_counter() - wall) / count
    print(json.dumps([*spent, peak_megabytes()]))


def main() -> None:
    """Measure all methods and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--checkout", type=Path)
    parser.add_argument("--scene", type=Path)
    parser.add_argument("--queries", type=int, default=8)
    parser.add_argument("--one", choices=METHODS, help=argparse.SUPPRESS)
    parser.add_argument("--threads", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--kept", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        _measure(args)
        return
    print("method      threads  processor s  wall s  peak MB")
    with tempfile.TemporaryDirectory() as kept:
        for threads, method in product((1, 2), METHODS if args.checkout else METHODS[:-1]):
            command = [sys.executable, "-m", "experiments.pixloc_cost", *sys.argv[1:]]
            command += ["--one", method, "--threads", str(threads), "--kept", kept]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
            processor, wall, peak = json.loads(done.stdout.splitlines()[-1])
            print(f"{method:12s}{threads:6d}{processor:13.2f}{wall:9.2f}{peak:9.0f}", flush=True)


if __name__ == "__main__":
    with ProcessTuning():  # as the command line
        main()
