"""Run two methods on the same queries from the same starts, and compare them.

python examples/05_compare_two_methods.py [SCENE] [RESULTS] [BOARD]    (after 01_map.py)
"""

from pathlib import Path

import benchmark
import objconnect as oc


def main(
    path: Path = Path("runs/examples/scene"),
    out: Path = Path("runs/examples/results"),
    board: Path = Path("runs/examples/board"),
) -> None:
    # The prior of every method is the true pose, moved by 3 m and rotated by 5 degrees.
    start = benchmark.parse_start("error=3m,5deg")
    (dataset,) = benchmark.open_datasets(path)
    for name in ("sift", "pixloc"):
        results = benchmark.evaluate(dataset, oc.create_localizer(name, {}), out / "from-3m", start)
        print(f"{name}: {results.summary.failed} of {results.summary.queries} queries failed")

    # Markdown here; leaderboard.html in the folder opens in a browser.
    print(benchmark.leaderboard([out / "from-3m"], board))


if __name__ == "__main__":
    oc.run_script(main)
