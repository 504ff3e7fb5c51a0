"""Share of segmentation in the cost of a query of the object-connect network with all its blocks.

``python -m experiments.segmentation_cost SCENE [--queries 10]`` prints the median milliseconds of a
core for SLIC and for Felzenszwalb's segments, over queries spread over a scene, with starts wrong
by 3 m and 5 degrees.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from statistics import median
from time import process_time

import numpy as np
import torch
from torch import Tensor

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import move_prior
from objconnect.network import network
from objconnect.network.config import ObjConnectNetConfig
from objconnect.network.localizer import SHIPPED, ObjConnectConfig, ObjConnectLocalizer
from objconnect.network.segmentation import segment

_KINDS = ("slic", "felzenszwalb")


def main(scene: Path, count: int) -> None:
    """Print the milliseconds of each segmentation, and of the whole query."""
    dataset = open_datasets(scene)[0]
    chosen = [
        dataset.queries[k] for k in np.linspace(0, len(dataset.queries) - 1, count, dtype=int)
    ]
    queries = [q.load(move_prior(q.reference, q.name, 3.0, 5.0)) for q in chosen]
    localizer = ObjConnectLocalizer(
        ObjConnectConfig(weights=SHIPPED.with_name("objconnect-objects.safetensors"))
    )
    localizer.prepare(dataset.load_map(), dataset.images)
    spent: list[float] = []
    for kind in _KINDS:

        def time_segmentation(
            images: Tensor, config: ObjConnectNetConfig, kind: str = kind
        ) -> Tensor:
            begun = process_time()
            labels = segment(images, config.model_copy(update={"segmentation": kind}))
            spent.append(process_time() - begun)
            return labels

        network.segment = time_segmentation
        whole = []
        for query in (queries[0], *queries):  # the first one warms up
            spent.clear()
            begun = process_time()
            localizer.localize(query)
            whole.append((process_time() - begun, sum(spent)))
        query_ms, segmentation_ms = (1000 * median(each) for each in zip(*whole[1:], strict=True))
        print(
            f"{kind}: {segmentation_ms:.0f} of {query_ms:.0f} ms, "
            f"{100 * segmentation_ms / query_ms:.0f} %"
        )


if __name__ == "__main__":
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path)
    parser.add_argument("--queries", type=int, default=10)
    arguments = parser.parse_args()
    main(arguments.scene, arguments.queries)
