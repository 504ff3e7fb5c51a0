"""Run two methods on the same queries from the same starts, and compare them.

python examples/05_compare_two_methods.py [SCENE] [RESULTS] [BOARD]    (after 01_map.py)
"""

from pathlib import Path

from benchmark.api import (
    create_localizer,
    evaluate,
    leaderboard,
    open_datasets,
    parse_start,
    run_script,
)


def main(
    path: Path = Path("runs/examples/scene"),
    out: Path = Path("runs/examples/results"),
    board: Path = Path("runs/examples/board"),
) -> None:
    # Every method is told the true pose moved by 3 m and turned by 5 degrees, and no more.
    start = parse_start("error=3m,5deg")
    (dataset,) = open_datasets(path)
    for name in ("sift", "pixloc"):
        results = evaluate(dataset, create_localizer(name, {}), out / "from-3m", start)
        print(f"{name}: {results.summary.failed} of {results.summary.queries} queries failed")

    # Markdown here; leaderboard.html in the folder opens in a browser.
    print(leaderboard([out / "from-3m"], board))


if __name__ == "__main__":
    run_script(main)
