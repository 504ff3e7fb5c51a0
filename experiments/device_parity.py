"""Compare poses on the processor and on a CUDA device: ``python -m experiments.device_parity``.

Localizes queries of a data set with an inexact prior, then without a prior. Each device prepares
the map itself. Prints the largest difference of poses and the ratio of seconds. Networks compute in
single precision on both devices, so that only rounding differs.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import torch

from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import parse_start
from benchmark.gate.scene import GATE_SCENES
from objconnect.methods import create
from objconnect.scene.geometry.pose import Pose

METHODS: Final = ("objconnect", "pixloc", "pixloc-search", "place", "d2net")
STARTS: Final = ("error=3m,5deg", "none")


class Answers(NamedTuple):
    """The answers of a method to queries on one device.

    Attributes:
        poses: ``cam_from_world`` by the name of the query; None without a pose.
        seconds: wall-clock time of all queries, without the preparation of the map.
    """

    poses: dict[str, Pose | None]
    seconds: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line per method and start."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path, nargs="?", default=GATE_SCENES["gate-snow"])
    parser.add_argument("--methods", nargs="+", default=METHODS)
    parser.add_argument("--device", default="cuda", help="compared with cpu")
    parser.add_argument("--every", type=int, default=1, help="take every n-th query")
    args = parser.parse_args(arguments)
    if args.device != "cpu" and not torch.cuda.is_available():
        print("torch finds no CUDA device here: there is nothing to compare")
        return
    (dataset,) = open_datasets(args.scene)
    for method in args.methods:
        for start in STARTS:
            both = [
                localize_queries(dataset, method, d, start, args.every)
                for d in ("cpu", args.device)
            ]
            print(f"{method}, {start}: {compare(*both)}", flush=True)


def localize_queries(
    dataset: Dataset, method: str, device: str, start: str, every: int = 1
) -> Answers:
    """Localize every n-th query of a data set on a device."""
    settings = (
        {"device": device} if method == "d2net" else {"device": device, "precision": "float32"}
    )
    localizer, sparse_map = create(method, settings), dataset.load_map()
    with tempfile.TemporaryDirectory() as folder:
        load = parse_start(start).loader(dataset, sparse_map, Path(folder))
        localizer.prepare(sparse_map, dataset.images, Path(folder))
        queries = [load(query) for query in dataset.queries[::every]]
        localizer.localize(queries[0])  # warm-up
        begin = time.perf_counter()
        poses = {query.name: localizer.localize(query).cam_from_world for query in queries}
        return Answers(poses, time.perf_counter() - begin)


def compare(first: Answers, second: Answers) -> str:
    """Return a line with the differences of poses of two devices and the ratio of seconds."""
    differences = [
        tuple(map(float, pose.error_to(other)))
        for name, pose in first.poses.items()
        if pose is not None and (other := second.poses[name]) is not None
    ]
    metres, degrees = (
        (max(each, default=0.0) for each in zip(*differences, strict=True))
        if differences
        else (0.0, 0.0)
    )
    on_one_device = sum(
        (pose is None) != (second.poses[name] is None) for name, pose in first.poses.items()
    )
    return (
        f"{len(differences)} poses, at most {metres:.2g} m and {degrees:.2g} deg apart, "
        f"{on_one_device} of one device alone; {second.seconds / first.seconds:.2f} of the seconds"
    )


if __name__ == "__main__":
    main()
