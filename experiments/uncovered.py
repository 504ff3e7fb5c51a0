"""False fixes outside the map: queries of one site, localized in the map of another.

    python -m experiments.uncovered SCENE OTHER [--method NAME] [--start START] [--only PREFIX]
        [--cache CACHE]

Every answer ``ok`` is a false fix. The prior of a query does not help: it refers to its own site,
whose coordinates overlap those of the other.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import parse_start
from benchmark.scoring.intervals import share
from objconnect.methods import create
from objconnect.scene.localizer import Status
from objconnect.scene.runtime.progress import progress_bar


def main() -> None:
    """Localize the queries, and print the number of answers and the reasons of failures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("other", type=Path)
    parser.add_argument("--method", default="objconnect")
    parser.add_argument("--start", default="none", type=parse_start)
    parser.add_argument("--only", default="", help="localize only queries whose names begin so")
    parser.add_argument("--cache", type=Path)
    args = parser.parse_args()
    (dataset,), (other,) = open_datasets(args.scene), open_datasets(args.other)
    localizer = create(args.method, {})
    cache = args.cache or Path(tempfile.mkdtemp())
    localizer.prepare(other.load_map(), other.images, cache)
    load = args.start.loader(dataset, dataset.load_map(), cache)
    queries = [query for query in dataset.queries if query.name.startswith(args.only)]
    answered = []
    with progress_bar(f"{dataset.name} in {other.name}", len(queries)) as advance:
        for done, query in enumerate(queries, 1):
            if localizer.localize(load(query)).status is Status.OK:
                answered.append(query.name)
            advance(done)
    courses = [dataset.courses[query.group] for query in queries]
    false = share([query.name in answered for query in queries], courses)
    print(
        f"{dataset.name} in {other.name}, {args.start.name}: {len(answered)} of {len(queries)} "
        f"are false fixes, {false.text()} %",
        *answered,
        sep="\n  ",
    )


if __name__ == "__main__":
    main()
