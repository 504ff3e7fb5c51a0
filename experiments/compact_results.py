"""Cost of compact results: bytes per query, and seconds to read the results of a whole track.

    python -m experiments.compact_results [RESULTS...] [--files N]

The first line is an artificial data set of 320 queries with random numbers, which compress worst.
The others are results files. The last line holds the time to read N files of 320 queries, compact
and plain in turn.
"""

from __future__ import annotations

import argparse
import random
import tempfile
import time
from pathlib import Path

from benchmark.results.results import Results
from benchmark.results.results_files import load, results_files
from benchmark.tracks.compact import write_compact
from tests.benchmark.tracks.test_compact import make, run_of


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("results", nargs="*", type=Path)
    parser.add_argument("--files", type=int, default=150)
    args = parser.parse_args()
    rng = random.Random(0)
    random_run = run_of([make(f"s{k // 40}/images/{k % 40:06d}.jpg", rng) for k in range(320)])
    runs = {"random numbers": random_run}
    runs |= {str(file): load(file) for path in args.results for file in results_files(path)}
    with tempfile.TemporaryDirectory() as folder:
        print("| results | queries | bytes a query | compact |\n|---|--:|--:|--:|")
        for name, run in runs.items():
            plain, compact = _write(run, Path(folder))
            sizes = [path.stat().st_size / len(run.queries) for path in (plain, compact)]
            print(f"| {name} | {len(run.queries)} | {sizes[0]:.0f} | {sizes[1]:.0f} |")
        files = _write(random_run, Path(folder))
        spent = [0.0, 0.0]
        for _ in range(args.files):
            for k, path in enumerate(files):
                before = time.process_time()
                load(path)
                spent[k] += time.process_time() - before
        print(f"{args.files} files: plain {spent[0]:.1f} s, compact {spent[1]:.1f} s")


def _write(run: Results, folder: Path) -> tuple[Path, Path]:
    plain, compact = folder / "a.json", folder / "a.json.xz"
    run.write(plain)
    write_compact(compact, run)
    return plain, compact


if __name__ == "__main__":
    main()
