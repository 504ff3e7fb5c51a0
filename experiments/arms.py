"""Compare arms: runs of one method on the same queries that differ in one option.

    objconnect evaluate SCENES/* --method objconnect --start none --out BOTH
    objconnect evaluate SCENES/* --method objconnect --start none --set objects=null --out TILTS
    python -m experiments.arms SCENES/* --arm both=BOTH --arm tilts=TILTS

Prints a table of recall at 0.5 m, 5 degrees by the true tilt of the camera, with false fixes and
seconds, and a table that pairs each further arm with the first. Only changed queries count, whose
condition is not the map's. Intervals and p values are by course.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.results.query_result import TOTAL, QueryResult
from benchmark.results.results_files import load
from benchmark.scoring.clustered import difference_interval, permutation_p
from benchmark.scoring.score import THRESHOLDS, is_correct, is_false_fix, recall
from experiments.figure_values import p_text
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.views import tilt

# Upper ends of the bands of tilt, degrees.
_BANDS_DEG: Final = (15, 30, 90)
_FOUND: Final = THRESHOLDS[1]

Answers = Mapping[tuple[str, str], QueryResult]
"""Results of an arm by data set and photograph."""


def read_arm(folder: Path, method: str, scenes: Sequence[Path]) -> Answers:
    """Read the results of an arm on the changed queries of scenes.

    Courses are named by data set, because those of two places are independent.

    Raises:
        InputError: results are missing or damaged.
    """
    answers = {}
    for scene in scenes:
        path = folder / scene.name / f"{method}.json"
        run = load(path)
        for query in run.queries:
            if query.condition not in run.dataset.map_conditions:
                course = f"{scene.name}/{query.course_name}"
                answers[scene.name, query.name] = query.model_copy(update={"course": course})
    return answers


def read_tilts(scenes: Sequence[Path]) -> dict[tuple[str, str], float]:
    """Return the true tilt of every photograph of scenes, degrees from straight down."""
    tilts = {}
    for path in scenes:
        scene = Scene.open(path)
        for session in scene.sessions:
            frames = scene.frames(session)
            for name, pose in zip(frames.names, frames.cam_from_world, strict=True):
                tilts[path.name, name] = float(np.degrees(tilt(np.asarray(pose)[:3, :3])))
    return tilts


def bands(tilts: NDArray[np.float64]) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield the name and the queries of each band of tilt, and of all."""
    lowest = 0
    for highest in _BANDS_DEG:
        name = f"{lowest} to {highest}°" if highest < _BANDS_DEG[-1] else f"{lowest}° and more"
        yield name, (tilts >= lowest) & (tilts < highest)
        lowest = highest
    yield "all", np.full(len(tilts), True)


def print_recall(arms: Mapping[str, Sequence[QueryResult]], tilts: NDArray[np.float64]) -> None:
    """Print recall by tilt, false fixes and seconds of each arm."""
    parts = list(bands(tilts))
    heads = [f"{name} ({int(rows.sum())})" for name, rows in parts]
    print("| arm |", " | ".join([*heads, "false fixes", "seconds"]), "|")
    print("|---|" + "--:|" * (len(heads) + 2))
    for arm, answers in arms.items():
        cells = [
            recall([answers[row] for row in np.flatnonzero(rows)], _FOUND).text()
            for _, rows in parts
        ]
        cells += [
            str(sum(map(is_false_fix, answers))),
            f"{median(answer.seconds[TOTAL] for answer in answers):.2f}",
        ]
        print(f"| {arm} |", " | ".join(cells), "|")


def print_pairs(arms: Mapping[str, Sequence[QueryResult]], tilts: NDArray[np.float64]) -> None:
    """Print what each further arm finds and misses against the first."""
    first, *others = arms
    right = {
        arm: np.array([is_correct(answer, _FOUND) for answer in answers])
        for arm, answers in arms.items()
    }
    courses = np.array([answer.course_name for answer in arms[first]])
    print(f"\n| against {first} | queries | won | lost | change, points | p |")
    print("|---|---|--:|--:|--:|--:|")
    for arm in others:
        for name, rows in bands(tilts):
            before, after = right[first][rows], right[arm][rows]
            paired = before.tolist(), after.tolist(), courses[rows].tolist()
            interval = difference_interval(*paired)
            change = 100 * float(after.mean() - before.mean())
            ends = "–" if interval is None else "{:.1f}, {:.1f}".format(*interval)
            counts = int((after & ~before).sum()), int((before & ~after).sum())
            p = p_text(permutation_p(*paired))
            print(f"| {arm} | {name} | {counts[0]} | {counts[1]} | {change:.1f} [{ends}] | {p} |")


def main() -> None:
    """Read the arms and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--arm", action="append", required=True, metavar="NAME=RESULTS")
    parser.add_argument("--method", default="objconnect")
    args = parser.parse_args()
    folders = dict(arm.split("=", 1) for arm in args.arm)
    answers = {
        arm: read_arm(Path(folder), args.method, args.scenes) for arm, folder in folders.items()
    }
    names = list(next(iter(answers.values())))
    for arm, found in answers.items():
        if set(found) != set(names):
            raise InputError(
                f"the queries of the arm {arm} differ from those of {next(iter(answers))}"
            )
    true_tilts = read_tilts(args.scenes)
    tilts = np.array([true_tilts[name] for name in names])
    arms = {arm: [found[name] for name in names] for arm, found in answers.items()}
    print(
        f"{len(names)} queries, {len({a.course_name for a in next(iter(arms.values()))})} courses\n"
    )
    print_recall(arms, tilts)
    print_pairs(arms, tilts)


if __name__ == "__main__":
    main()
