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
from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import parse_start
from objconnect.methods import create
from objconnect.scene.localizer import Estimate, Status
from objconnect.scene.runtime.progress import progress_bar


class TimedQuery(NamedTuple):
    """A localized query.

    Attributes:
        flight: name of its flight, and of its place if that is not the map's.
        seconds: wall-clock seconds.
        estimate: its estimate.
        is_right: whether the answer is within 0.5 m and 5 degrees.
        is_false: whether the answer is wrong by more than 5 m or 10 degrees.
    """

    flight: str
    seconds: float
    estimate: Estimate
    is_right: bool
    is_false: bool


def judge(query: BenchmarkQuery, estimate: Estimate, elsewhere: bool) -> tuple[bool, bool]:
    """Return whether an answer is right, and whether it is false."""
    if estimate.status is not Status.OK or estimate.cam_from_world is None:
        return False, False
    metres, degrees = (float(e) for e in estimate.cam_from_world.error_to(query.reference))
    right = metres <= 0.5 and degrees <= 5 and not elsewhere
    return right, elsewhere or metres > 5 or degrees > 10


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
        load = parse_start("none").loader(dataset, dataset.load_map(), cache)
        localizer.localize(load(dataset.queries[0]))  # warm-up
        queries = dataset.queries[:: args.every]
        with progress_bar(dataset.name, len(queries)) as advance:
            for done, query in enumerate(queries, 1):
                loaded = load(query)
                begin = time.perf_counter()
                estimate = localizer.localize(loaded)
                seconds = time.perf_counter() - begin
                elsewhere = dataset is other
                name = f"{query.group} of {dataset.name}" if elsewhere else query.group
                timed.append(
                    TimedQuery(name, seconds, estimate, *judge(query, estimate, elsewhere))
                )
                advance(done)

    localize_all(place)
    localize_all(other)
    print("| flight | queries | found | false | answered, s | not answered, s |")
    print("|---|--:|--:|--:|--:|--:|")
    for flight in dict.fromkeys(each.flight for each in timed):
        some = [each for each in timed if each.flight == flight]
        answered = [e.seconds for e in some if e.estimate.status is Status.OK]
        others = [e.seconds for e in some if e.estimate.status is not Status.OK]
        print(
            f"| {flight} | {len(some)} | {sum(e.is_right for e in some)} "
            f"| {sum(e.is_false for e in some)} | {summarize(answered)} | {summarize(others)} |"
        )


if __name__ == "__main__":
    main()
