"""Cost of a rendered photograph on disk and in `map` and `evaluate`.

`python -m experiments.unit_cost SCENE` prints bytes on disk, and processor seconds of one core for
each step of `map` and `evaluate`: medians over eight photographs, pairs or queries. The scene needs
its map.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import torch

from benchmark.datasets.simulated import open_scene
from benchmark.evaluation.starts import PRIOR
from objconnect.localization.pipeline.failures import localize_safely
from objconnect.methods import create
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.colmap.sift import extract_sift
from objconnect.scene.maps.features import unit_descriptors
from objconnect.scene.maps.matching import match
from objconnect.scene.runtime.tuning import ProcessTuning
from simulate.annotations import measure_covisibility, pixel_digests

# Number of photographs, pairs or queries of which a median is taken.
_SAMPLES = 8


def unit_cost(scene: Scene) -> Iterator[tuple[str, str]]:
    """Yield the name and the cost of each part."""
    photographs = list(scene.images_root.rglob("*.jpg"))
    root, map_names, count = scene.images_root, scene.splits.map, len(photographs)
    yield "JPEG of a photograph", _kilobytes(photographs, count)
    yield "its layers", _kilobytes(root.rglob("*.h5"), count)
    yield "map, of a photograph", _kilobytes(scene.map_path.rglob("*"), len(map_names))
    for name, run in (("covisibility", measure_covisibility), ("digests", pixel_digests)):
        began = time.process_time()
        run(scene)
        spent = (time.process_time() - began) / count
        yield f"{name}, of one of {count}", f"{spent:.3f} cpu-s"
    options = SiftOptions()
    found = extract_sift(root, map_names[:_SAMPLES], options, threads=1)
    names = list(found)
    descriptors = [unit_descriptors(found[name].descriptors) for name in names]
    sift = _seconds(lambda k: extract_sift(root, [names[k]], options, threads=1))
    yield "SIFT of a photograph", sift
    yield "matching a pair", _seconds(lambda k: match(descriptors[k - 1], descriptors[k], 0.8))
    dataset = open_scene(scene.path)
    localizer, sparse_map = create("sift", {}), dataset.load_map()
    localizer.prepare(sparse_map, dataset.images)
    load, queries = PRIOR.loader(dataset, sparse_map), dataset.queries[:_SAMPLES]
    yield (
        "a query of sift",
        _seconds(lambda k: localize_safely(localizer, load(queries[k % len(queries)]))),
    )


def _kilobytes(files: Iterable[Path], count: int) -> str:
    total = sum(file.stat().st_size for file in files if file.is_file())
    return f"{total / count / 1e3:.0f} kB"


def _seconds(run: Callable[[int], object]) -> str:
    spent = []
    for k in range(_SAMPLES):
        began = time.process_time()
        run(k)
        spent.append(time.process_time() - began)
    return f"{np.median(spent):.2f} cpu-s"


def main() -> None:
    """Print the costs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    torch.set_num_threads(1)
    for name, cost in unit_cost(Scene.open(parser.parse_args().scene)):
        print(f"{name:<28}{cost}", flush=True)


if __name__ == "__main__":
    with ProcessTuning():  # as the command line
        main()
