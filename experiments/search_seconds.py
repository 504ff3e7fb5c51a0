"""Seconds of queries without a prior in the map of their own place and in that of another.

    python -m experiments.search_seconds PLACE OTHER [--every N] [--cache CACHE] [--threads N]
        [--set KEY=VALUE]

The table states for each flight of PLACE, and of OTHER in PLACE's map, the number of queries, how
many are found within 0.5 m and 5 degrees, the false fixes, and the wall-clock seconds of a query:
the median and the largest of answered ones, and the median and the largest of all others. Queries
of OTHER show nothing of the map. Run it on a machine without other work.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from benchmark.cli.arguments import parse_settings
from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.scored_query import score_query
from benchmark.evaluation.starts import parse_start
from benchmark.results.query_result import QueryResult
from benchmark.scoring.score import THRESHOLDS, is_correct, is_false_fix
from objconnect.methods import create
from objconnect.scene.localizer import Status
from objconnect.scene.runtime.progress import progress_bar


class TimedQuery(NamedTuple):
    """A localized query.

    Attributes:
        flight: name of its flight, and of its place if that is not the map's.
        is_elsewhere: whether the map does not show its place, so that every answer is false.
        seconds: wall-clock seconds.
        result: its answer, with the errors.
    """

    flight: str
    is_elsewhere: bool
    seconds: float
    result: QueryResult

    @property
    def is_found(self) -> bool:
        """Whether the answer is within 0.5 m and 5 degrees."""
        return not self.is_elsewhere and is_correct(self.result, THRESHOLDS[1])

    @property
    def is_false(self) -> bool:
        """Whether the answer is a false fix."""
        return is_false_fix(self.result) or (self.is_elsewhere and self.is_answered)

    @property
    def is_answered(self) -> bool:
        """Whether there is an answer."""
        return self.result.status is Status.OK


def summarize(seconds: list[float]) -> str:
    """Return the median and the largest of some seconds; a dash for none."""
    return f"{np.median(seconds):.2f}, {max(seconds):.2f}" if seconds else "–"


def main() -> None:
    """Localize the queries of both places, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("place", type=Path)
    parser.add_argument("other", type=Path)
    parser.add_argument("--every", type=int, default=1, help="take every n-th query")
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--set", action="append", default=[], dest="overrides")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    (place,), (other,) = open_datasets(args.place), open_datasets(args.other)
    cache = args.cache or Path(tempfile.mkdtemp())
    localizer = create("objconnect", parse_settings(args.overrides))
    localizer.prepare(place.load_map(), place.images, cache)
    timed: list[TimedQuery] = []

    def localize_all(dataset: Dataset) -> None:
        sparse_map = dataset.load_map()
        load = parse_start("none").loader(dataset, sparse_map, cache)
        localizer.localize(load(dataset.queries[0]))  # warm-up
        queries = dataset.queries[:: args.every]
        with progress_bar(dataset.name, len(queries)) as advance:
            for done, query in enumerate(queries, 1):
                loaded = load(query)
                begin = time.perf_counter()
                estimate = localizer.localize(loaded)
                seconds = time.perf_counter() - begin
                name = f"{query.group} of {dataset.name}" if dataset is other else query.group
                course = dataset.courses[query.group]
                result = score_query(query, course, estimate, sparse_map, seconds)
                timed.append(TimedQuery(name, dataset is other, seconds, result))
                advance(done)

    localize_all(place)
    localize_all(other)
    print("| flight | queries | found | false | answered, s | not answered, s |")
    print("|---|--:|--:|--:|--:|--:|")
    for flight in dict.fromkeys(each.flight for each in timed):
        some = [each for each in timed if each.flight == flight]
        answered = [each.seconds for each in some if each.is_answered]
        others = [each.seconds for each in some if not each.is_answered]
        found, false = sum(each.is_found for each in some), sum(each.is_false for each in some)
        seconds = f"{summarize(answered)} | {summarize(others)}"
        print(f"| {flight} | {len(some)} | {found} | {false} | {seconds} |")


if __name__ == "__main__":
    main()
