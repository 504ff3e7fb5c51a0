"""How often the first and the first eight candidates of a search lie near the truth, by tilt.

    python -m experiments.candidates DATASET [DATASET ...] [--every N] [--cache CACHE]

Queries are searched by ``objconnect`` without a prior. A candidate is *near* within 8 m, 10 degrees
of the reference. Candidates come in lists: those of the objects, of the coarse search, and of the
coarse search at other tilts. The table tells, for each list and range of true tilts, the number of
queries whose first candidate is near, or one of the first eight, and the processor seconds a query.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from time import process_time
from typing import Final, NamedTuple

import numpy as np
import torch

from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from objconnect.localization.coarse.search import Candidate
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.methods import create
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import tilt
from objconnect.scene.localizer import Stopwatch
from objconnect.scene.runtime.progress import progress_bar

_NEAR_M, _NEAR_DEG = 8.0, 10.0
_FIRST: Final = 8
# Bounds of the ranges of tilts, degrees.
_TILTS_DEG: Final = (0, 10, 20, 30, 40, 50, 60, 90)


class Ranked(NamedTuple):
    """A list of candidates of a query.

    Attributes:
        number: number of the list.
        tilt_deg: true tilt of the query, degrees.
        rank: number of the first near candidate, from 1; infinite if there is none.
        seconds: processor seconds of the list.
    """

    number: int
    tilt_deg: float
    rank: float
    seconds: float


def rank_candidates(candidates: Sequence[Candidate], truth: Pose) -> float:
    """Return the number of the first candidate near the truth, from 1; infinite without one."""
    for number, candidate in enumerate(candidates, 1):
        metres, degrees = candidate.pose.error_to(truth)
        if metres < _NEAR_M and degrees < _NEAR_DEG:
            return number
    return math.inf


def rank_dataset(dataset: Dataset, every: int, cache: Path) -> Iterator[Ranked]:
    """Yield the candidates of each finder for every N-th query."""
    localizer = create("objconnect", {"matches": None, "tracking": None})
    assert isinstance(localizer, FeaturemetricLocalizer)
    localizer.prepare(dataset.load_map(), dataset.images, cache)
    search, queries = localizer.map_state.search, dataset.queries[::every]
    with progress_bar(dataset.name, len(queries)) as advance, torch.inference_mode():
        for done, query in enumerate(queries, 1):
            degrees = math.degrees(tilt(query.reference.rotation.numpy()))
            loaded = query.load()
            begin = process_time()
            for number, found in enumerate(search.find(loaded, Stopwatch()), 1):
                rank = rank_candidates(found, query.reference)
                yield Ranked(number, degrees, rank, process_time() - begin)
                begin = process_time()
            advance(done)


def _print_table(ranked: Sequence[Ranked]) -> None:
    print("| list | tilt, deg | queries | first | first eight | seconds |")
    print("|--:|--:|--:|--:|--:|--:|")
    for number in dict.fromkeys(each.number for each in ranked):
        for low, high in pairwise(_TILTS_DEG):
            some = [r for r in ranked if r.number == number and low <= r.tilt_deg < high]
            if some:
                first = sum(each.rank == 1 for each in some)
                among = sum(each.rank <= _FIRST for each in some)
                seconds = np.median([each.seconds for each in some])
                shown = f"{low} to {high} | {len(some)} | {first} | {among} | {seconds:.2f}"
                print(f"| {number} | {shown} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("datasets", nargs="+", type=Path)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--cache", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(1)
    cache = args.cache or Path(tempfile.mkdtemp())
    _print_table(
        [
            ranked
            for path in args.datasets
            for dataset in open_datasets(path)[:1]
            for ranked in rank_dataset(dataset, args.every, cache)
        ]
    )


if __name__ == "__main__":
    main()
