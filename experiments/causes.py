"""Why queries are not found: what alignment makes of the true pose.

    python -m experiments.causes DATASET [DATASET ...] --results RESULTS [RESULTS ...]
        [--cache CACHE]

RESULTS are folders with results of ``objconnect`` on these data sets, such as
``benchmark/tracks/real-seasons/results/none``; each gives a table. A query is *found* if its answer
is within 1 m, 5 degrees. The others are aligned from the reference pose:

- *features*: the pose leaves the reference by more than 0.5 m on the ground. The features of both
  dates differ, and no start would help.
- *tilt*: it stays within 0.5 m on the ground, but the camera is off by more than 1 m, or its sigma
  exceeds the bound of an answer. Tilt and position compensate each other over flat ground.
- *probability*: it stays within 1 m, and its probability is too low for an answer.
- *start*: it would be an answer. No start led to it.

The error on the ground is the mean horizontal distance between the points of level ground that the
two poses see at the picture's centre and halfway to its corners.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.datasets.open import open_datasets
from benchmark.results.query_result import QueryResult
from benchmark.results.results_files import load
from objconnect.localization.featuremetric.attempt import select_likeliest, sigma_m
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.methods import create
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Status, Stopwatch
from objconnect.scene.runtime.progress import progress_bar

_FOUND_M, _FOUND_DEG = 1.0, 5.0
_ON_GROUND_M: Final = 0.5
# Options that switch off the parts that only a search needs.
_NO_SEARCH: Final = {"matches": None, "objects": None, "place": {"candidates": 0}}
_SUFFIXES: Final = (".json", ".json.xz")
CAUSES: Final = ("found", "start", "probability", "tilt", "features")


class Case(NamedTuple):
    """The result of aligning a query from its true pose.

    Attributes:
        cause: why the query is not found if it is not, one of ``CAUSES``.
        metres: position error.
        on_ground_m: error on the ground, as in the head of this module.
        tilt_deg: angle between the optical axis and the vertical.
        pixel_m: size of a pixel on the ground, metres.
    """

    cause: str
    metres: float
    on_ground_m: float
    tilt_deg: float
    pixel_m: float


def find_causes(dataset: Dataset, cache: Path) -> Iterator[tuple[str, Case]]:
    """Yield names and cases of the queries of a data set."""
    localizer = create("objconnect", _NO_SEARCH)
    assert isinstance(localizer, FeaturemetricLocalizer)
    sparse_map = dataset.load_map()
    localizer.prepare(sparse_map, dataset.images, cache)
    ground = float(np.median(sparse_map.xyz[:, 2]))
    with progress_bar(dataset.name, len(dataset.queries)) as advance:
        for done, query in enumerate(dataset.queries, 1):
            yield query.name, _find_cause(localizer, query, ground)
            advance(done)


def _find_cause(localizer: FeaturemetricLocalizer, query: BenchmarkQuery, ground: float) -> Case:
    options, truth = localizer.config.search, query.reference
    with torch.inference_mode():
        attempt = localizer.map_state.refine.align_near(query.load(), truth, Stopwatch())
    metres = ground_error_m = math.inf
    if not attempt.has_failed:
        metres = float(attempt.pose.error_to(truth)[0])
        seen = [find_seen_ground(pose, query.camera, ground) for pose in (attempt.pose, truth)]
        ground_error_m = float(np.linalg.norm(seen[0] - seen[1], axis=1).mean())
    _, probability = select_likeliest([attempt])
    if ground_error_m > _ON_GROUND_M:
        cause = "features"
    elif metres > _FOUND_M or sigma_m(attempt, options) > options.most_sigma_m:
        cause = "tilt"
    else:
        cause = "start" if probability >= 1 - options.risk else "probability"
    tilt = math.degrees(math.acos(max(-1.0, min(1.0, -float(truth.rotation[2, 2])))))
    pixel = (float(truth.centre()[2]) - ground) / query.camera.focal[0]
    return Case(cause, metres, ground_error_m, tilt, pixel)


def _read_found(results: Path, dataset: str) -> set[str]:
    """Return the names of the queries that are found."""
    paths = [results / dataset / f"objconnect{suffix}" for suffix in _SUFFIXES]
    queries = load(next(path for path in paths if path.exists())).queries
    return {query.name for query in queries if _is_found(query)}


def _is_found(answer: QueryResult) -> bool:
    if answer.status is not Status.OK or answer.t_err_m is None or answer.r_err_deg is None:
        return False
    return answer.t_err_m < _FOUND_M and answer.r_err_deg < _FOUND_DEG


def find_seen_ground(pose: Pose, camera: Camera, ground: float) -> NDArray[np.float64]:
    """Return east and north (5, 2) of the level ground at five pixels of a picture."""
    offsets = np.array([(0, 0), (-1, -1), (-1, 1), (1, -1), (1, 1)]) / 4
    rays, _ = camera.unproject(torch.tensor((0.5 + offsets) * (camera.width, camera.height)))
    world = rays.numpy() @ pose.rotation.numpy()
    centre = pose.centre().numpy()
    return np.asarray((centre + world * ((ground - centre[2]) / world[:, 2:]))[:, :2])


def _print_table(cases: Sequence[Case]) -> None:
    print("| cause | queries | position, m | on the ground, m | tilt | pixel, m |")
    print("|---|--:|--:|--:|--:|--:|")
    for cause in CAUSES:
        some = np.array([each[1:] for each in cases if each.cause == cause]).reshape(-1, 4)
        if len(some):
            metres, ground_error_m, tilt, pixel = np.median(some, axis=0)
            print(
                f"| {cause} | {len(some)} | {metres:.2f} | {ground_error_m:.2f} | {tilt:.0f}° | "
                f"{pixel:.2f} |"
            )


def main() -> None:
    """Print the queries that are not found, and a table of each folder of results."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("datasets", type=Path, nargs="+")
    parser.add_argument("--results", type=Path, nargs="+", required=True)
    parser.add_argument("--cache", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(1)
    cache = args.cache or Path(tempfile.mkdtemp())
    datasets = [open_datasets(path)[0] for path in args.datasets]
    aligned = {dataset.name: dict(find_causes(dataset, cache)) for dataset in datasets}
    for results in args.results:
        cases: list[Case] = []
        for place, query_cases in aligned.items():
            found = _read_found(results, place)
            for query, case in query_cases.items():
                cases.append(case._replace(cause="found") if query in found else case)
                if query not in found:
                    print(results.name, place, query, case)
        _print_table(cases)


if __name__ == "__main__":
    main()
