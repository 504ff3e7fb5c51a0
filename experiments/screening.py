"""How well a rough alignment ranks candidate poses, by the resolution of the image.

    python -m experiments.screening DATASET [DATASET ...] [--every N] [--cache CACHE]

Queries are localized by ``objconnect`` without a prior and without matches. Every candidate is
aligned roughly at several resolutions (``featuremetric/screening.py``) and in full. A candidate is
*right* if its full alignment is within 1 m, 5 degrees of the reference. The table tells, for each
resolution, how often the highest peak is that of a right candidate (first), the least of the
highest peaks of right candidates, the 50, 90 and 99 % quantiles of the peaks of the others, and the
processor seconds of a rough alignment; the last line those of a full one.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from time import process_time
from typing import Final, NamedTuple

import numpy as np
import torch

from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import parse_start
from objconnect.localization.featuremetric.global_search import GlobalSearch
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.featuremetric.screening import rough_peak
from objconnect.methods import create
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Query, Stopwatch
from objconnect.scene.runtime.progress import progress_bar

# Metres per pixel as multiples of those of the map's photographs.
_COARSER: Final = (1.0, 1.5, 2.0)
_RIGHT_M, _RIGHT_DEG = 1.0, 5.0


class Screened(NamedTuple):
    """A candidate.

    Attributes:
        is_right: whether its full alignment is right.
        rough_peaks: peak-to-sidelobe ratios of the rough alignments, by ``_COARSER``.
        seconds: processor seconds of the rough alignments, and of the full one.
    """

    is_right: bool
    rough_peaks: tuple[float, ...]
    seconds: tuple[float, ...]


def screen_dataset(dataset: Dataset, every: int, cache: Path) -> Iterator[list[Screened]]:
    """Yield the candidates of every N-th query."""
    localizer = create("objconnect", {"matches": None, "tracking": None})
    assert isinstance(localizer, FeaturemetricLocalizer)
    sparse_map = dataset.load_map()
    localizer.prepare(sparse_map, dataset.images, cache)
    load = parse_start("none").loader(dataset, sparse_map, cache)
    queries = dataset.queries[::every]
    with progress_bar(dataset.name, len(queries)) as advance, torch.inference_mode():
        for done, query in enumerate(queries, 1):
            yield _screen_query(localizer.map_state.search, load(query), query.reference)
            advance(done)


def _screen_query(search: GlobalSearch, query: Query, truth: Pose) -> list[Screened]:
    screened, clock = [], Stopwatch()
    for candidates in search.find(query, clock):
        for candidate in candidates:
            times, rough_peaks = [process_time()], []
            for coarser in _COARSER:
                rough_peaks.append(rough_peak(search.refine, query, candidate, coarser))
                times.append(process_time())
            attempt = search.refine.align_near(query, candidate.pose, clock)
            times.append(process_time())
            is_right = False
            if not attempt.has_failed:
                metres, degrees = attempt.pose.error_to(truth)
                is_right = bool(metres < _RIGHT_M and degrees < _RIGHT_DEG)
            screened.append(Screened(is_right, tuple(rough_peaks), tuple(np.diff(times))))
    return screened


def _print_table(queries: list[list[Screened]]) -> None:
    findable = [each for each in queries if any(one.is_right for one in each)]
    seconds = np.mean([one.seconds for each in queries for one in each], axis=0)
    print(f"{len(findable)} of {len(queries)} queries have a right candidate")
    print("| coarser | first | least right | others: 50, 90, 99 % | seconds |")
    print("|--:|--:|--:|--:|--:|")
    for k, coarser in enumerate(_COARSER):
        peaks = defaultdict(list)
        for each in queries:
            for one in each:
                peaks[one.is_right].append(one.rough_peaks[k])
        first = sum(max(each, key=lambda one: one.rough_peaks[k]).is_right for each in findable)
        least = min(max(one.rough_peaks[k] for one in each if one.is_right) for each in findable)
        others = np.quantile(peaks[False], (0.5, 0.9, 0.99))
        shown = ", ".join(f"{value:.1f}" for value in others)
        print(f"| {coarser:g} | {first} | {least:.1f} | {shown} | {seconds[k]:.2f} |")
    print(f"full alignment: {seconds[-1]:.2f} s")


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
            screened
            for path in args.datasets
            for dataset in open_datasets(path)[:1]
            for screened in screen_dataset(dataset, args.every, cache)
        ]
    )


if __name__ == "__main__":
    main()
