"""Processor seconds of a query of objconnect with each precision of the network.

``python -m experiments.query_cost SCENE --cache CACHE`` localizes every query with each precision
in turn, in one thread. On a machine with other work, read the ratios.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import parse_start
from objconnect.methods import create
from objconnect.scene.localizer import Status
from objconnect.scene.runtime.tuning import ProcessTuning

PRECISIONS = ("float32", "bfloat16")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--start", default="error=3m,5deg")
    parser.add_argument("--every", type=int, default=1, help="take every n-th query")
    args = parser.parse_args()
    torch.set_num_threads(1)
    start = parse_start(args.start)
    (dataset,) = open_datasets(args.scene)
    sparse_map = dataset.load_map()
    methods = [create("objconnect", {"precision": each}) for each in PRECISIONS]
    for method in methods:
        method.prepare(sparse_map, dataset.images, args.cache)
    load = start.loader(dataset, sparse_map, args.cache)
    queries = dataset.queries[:: args.every]
    seconds = np.zeros((len(methods), len(queries)))
    errors = np.full((len(methods), len(queries)), np.inf)
    for method in methods:  # warm-up
        method.localize(load(queries[0]))
    for number, query in enumerate(queries):
        loaded = load(query)
        for row, method in enumerate(methods):
            begin = time.process_time()
            found = method.localize(loaded)
            seconds[row, number] = time.process_time() - begin
            if found.status is Status.OK and found.cam_from_world is not None:
                errors[row, number] = float(found.cam_from_world.error_to(query.reference)[0])
    for row, precision in enumerate(PRECISIONS):
        print(
            f"{precision}: {seconds[row].mean():.3f} s, "
            f"{seconds[row].sum() / seconds[0].sum():.2f} of float32's; "
            f"{(errors[row] < 0.5).sum()} of {len(queries)} within 0.5 m, "
            f"median {np.median(errors[row]):.3f} m"
        )


if __name__ == "__main__":
    with ProcessTuning():  # as the command line
        main()
