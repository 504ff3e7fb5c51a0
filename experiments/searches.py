"""Searches of ``objconnect`` without a prior, for experiments that examine candidates."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

import torch

from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import parse_start
from objconnect.localization.featuremetric.global_search import GlobalSearch
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.methods import create
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Query
from objconnect.scene.runtime.progress import progress_bar

T = TypeVar("T")


class SearchedQuery(NamedTuple):
    """A query without a prior, and the search that finds its candidates.

    Attributes:
        search: the search of the data set's map.
        query: the query.
        truth: its reference pose.
    """

    search: GlobalSearch
    query: Query
    truth: Pose


def open_searches(dataset: Dataset, every: int, cache: Path) -> Iterator[SearchedQuery]:
    """Yield every N-th query of a data set, with a search without matches and tracking."""
    localizer = create("objconnect", {"matches": None, "tracking": None})
    assert isinstance(localizer, FeaturemetricLocalizer)
    sparse_map = dataset.load_map()
    localizer.prepare(sparse_map, dataset.images, cache)
    load = parse_start("none").loader(dataset, sparse_map, cache)
    queries = dataset.queries[::every]
    with progress_bar(dataset.name, len(queries)) as advance, torch.inference_mode():
        for done, query in enumerate(queries, 1):
            yield SearchedQuery(localizer.map_state.search, load(query), query.reference)
            advance(done)


def measure_searches(description: str, measure: Callable[[SearchedQuery], T]) -> list[T]:
    """Return the measurement of every N-th query of the data sets on the command line.

    Args:
        description: documentation of the experiment; its first line is the help text.
        measure: function that measures a query.
    """
    parser = argparse.ArgumentParser(description=description.partition("\n")[0])
    parser.add_argument("datasets", nargs="+", type=Path)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--cache", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(1)
    cache = args.cache or Path(tempfile.mkdtemp())
    return [
        measure(searched)
        for path in args.datasets
        for dataset in open_datasets(path)[:1]
        for searched in open_searches(dataset, args.every, cache)
    ]
