"""Retrieval of street photographs by the features of several methods.

    python -m experiments.street_retrieval SCENE [SCENE ...] [--metres 10] [--degrees 30]
        [--cache CACHE]

The scenes have maps and queries of other conditions. A photograph is correct if it is within
--metres and --degrees of the query. Prints the share of queries with a correct photograph among the
first, first five and first ten: by VLAD of SIFT, by VLAD of the coarse features of the learned
methods, and by chance.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from benchmark.scoring.intervals import share
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.matching.structure import StructureLocalizer
from objconnect.methods import create
from objconnect.scene.localizer import Localizer
from objconnect.scene.runtime.progress import progress_bar

_METHODS = ("sift", "pixloc", "objconnect")
_FIRST = (1, 5, 10)


def _ranks(localizer: Localizer, dataset: Dataset) -> Iterator[NDArray[np.int64]]:
    """Yield the rows of the photographs most similar to each query, best first."""
    with progress_bar(f"{dataset.name} {localizer.name}", len(dataset.queries)) as advance:
        for done, query in enumerate(dataset.queries, 1):
            loaded = query.load()
            if isinstance(localizer, FeaturemetricLocalizer):
                with torch.inference_mode():
                    descriptors = localizer.map_state.refine.describe(loaded)
                yield localizer.map_state.refine.retrieval.index.rank(descriptors, max(_FIRST))
            else:
                assert isinstance(localizer, StructureLocalizer)
                yield localizer.find_similar(loaded, max(_FIRST))
            advance(done)


def _is_correct(dataset: Dataset, metres: float, degrees: float) -> NDArray[np.bool_]:
    """Return whether each map photograph is correct for each query (Q, N)."""
    sparse_map = dataset.load_map()
    is_correct = np.zeros((len(dataset.queries), len(sparse_map.names)), bool)
    for number, query in enumerate(dataset.queries):
        for row, name in enumerate(sparse_map.names):
            t, r = sparse_map.images[name].pose.error_to(query.reference)
            is_correct[number, row] = float(t) < metres and float(r) < degrees
    return is_correct


def main() -> None:
    """Rank the photographs for each query, and print the shares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--metres", type=float, default=10.0)
    parser.add_argument("--degrees", type=float, default=30.0)
    parser.add_argument("--cache", type=Path)
    args = parser.parse_args()
    cache = args.cache or Path(tempfile.mkdtemp())
    datasets = [dataset for scene in args.scenes for dataset in open_datasets(scene)]
    correct = [_is_correct(dataset, args.metres, args.degrees) for dataset in datasets]
    queries = sum(len(is_correct) for is_correct in correct)
    courses = [f"{d.name}/{d.courses[query.group]}" for d in datasets for query in d.queries]
    for method in _METHODS:
        hits: list[list[bool]] = []
        for dataset, is_correct in zip(datasets, correct, strict=True):
            localizer = create(method, {})
            localizer.prepare(dataset.load_map(), dataset.images, cache)
            for is_correct_for_query, rows in zip(
                is_correct, _ranks(localizer, dataset), strict=True
            ):
                hits.append([bool(is_correct_for_query[rows[:first]].any()) for first in _FIRST])
        for first, is_hit in zip(_FIRST, zip(*hits, strict=True), strict=True):
            print(f"{method} first {first}: {share(is_hit, courses).text()} %")
    for first in _FIRST:
        missed = [(~is_correct).mean(1) ** first for is_correct in correct]
        print(f"chance first {first}: {100 * (1 - np.concatenate(missed).mean()):.1f} %")
    without_correct = sum(int((~is_correct.any(1)).sum()) for is_correct in correct)
    print(f"{queries} queries, {without_correct} without any")


if __name__ == "__main__":
    main()
