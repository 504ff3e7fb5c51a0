"""The command ``score``, which scores the poses that another program estimated."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from benchmark.datasets.dataset import Dataset
from benchmark.evaluation.scored_query import score_query
from benchmark.evaluation.starts import Start, parse_start
from benchmark.results.query_result import QueryResult
from benchmark.results.results import DatasetId, Results
from benchmark.results.results_files import BASIN, check_results_output
from objconnect.localization.provenance import Method
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import read_poses
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Status
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.outputs import require_name


def score(
    poses: Path, datasets: Sequence[Dataset], method: str, out: Path, start: str = "none"
) -> list[Path]:
    """Score a file of poses and write ``OUT/<dataset>/<method>.json``.

    The file has hloc's format: lines ``name qw qx qy qz tx ty tz``, world to camera. A query
    without a line counts as failed. Names are those of the data set or, where that is not
    ambiguous, their last part, as hloc writes them for Aachen. Results of the same name are
    replaced only if this command wrote them.

    Args:
        poses: text file of the poses.
        datasets: data sets whose queries the file may contain.
        method: name of the method, which names the results files.
        out: folder of the results.
        start: information that the method had, see ``starts.parse_start``. Nothing verifies it,
            and tables print it "as declared".

    Returns:
        The results files that were written: one for each data set with a query in the file.

    Raises:
        InputError: the file cannot be read or has no pose, a pose belongs to no query, a query has
            two poses, ``start`` is unknown, the method is not a valid file name, or another
            command wrote results of this name.
    """
    require_method_name(method)
    starting_information = parse_start(start)
    pose_of = read_poses(poses)
    digest = sha256_of(poses)
    unused = set(pose_of)
    results: dict[Path, Results] = {}
    for dataset in datasets:
        names = _match_names(pose_of, dataset, poses)
        if not names:
            continue
        unused -= set(names.values())
        found = {query: pose_of[name] for query, name in names.items()}
        queries = score_poses(
            dataset, found, dataset.load_map(), starting_information, f"no line in {poses.name}"
        )
        made_by = Method.external(method, digest)
        target = out / dataset.name / f"{method}.json"
        check_results_output(target, made_by, out)
        results[target] = Results.of(
            made_by, DatasetId.of(dataset), starting_information.name, queries
        )
    if unused:
        raise InputError(
            f"{poses}: {len(unused)} poses belong to no query of the data sets, such as "
            f"{min(unused)}: remove these lines, or give their data set with --reference"
        )
    if not results:
        raise InputError(f"{poses} contains no pose: write lines name qw qx qy qz tx ty tz")
    for target, scores in results.items():
        scores.write(target)
    return list(results)


def require_method_name(method: str) -> None:
    """Refuse a method name that is not a valid name for a results file.

    Raises:
        InputError: the name is not a valid file name, or ends like ``*.basin.json`` (basins of
            convergence).
    """
    require_name(method, "method")
    if f"{method}.json".endswith(BASIN):
        raise InputError(
            f"method {method!r}: the ending {BASIN} is reserved for basin files: choose another "
            "--method"
        )


def score_poses(
    dataset: Dataset,
    poses: Mapping[str, Pose],
    sparse_map: SparseMap,
    start: Start,
    missing: str,
) -> list[QueryResult]:
    """Score poses of another program.

    Args:
        dataset: data set of the queries.
        poses: cam_from_world by name of the query.
        sparse_map: its map.
        start: information on each query that the program had besides its image.
        missing: reason why a query without a pose failed.
    """
    queries = []
    for query in dataset.queries:
        if query.name in poses:
            estimate = Estimate(Status.OK, poses[query.name])
        else:
            estimate = Estimate(Status.FAILED, reason=missing)
        course = dataset.courses[query.group]
        prior = query.prior if start.kind == "prior" else None
        queries.append(score_query(query, course, estimate, sparse_map, None, prior))
    return queries


def _match_names(in_file: Collection[str], dataset: Dataset, poses: Path) -> dict[str, str]:
    """Return the name in the file by the name of the query, for queries that have a line."""
    by_last_part: dict[str, list[str]] = {}
    for query in dataset.queries:
        by_last_part.setdefault(Path(query.name).name, []).append(query.name)
    names: dict[str, str] = {}
    full_names = {query.name for query in dataset.queries}
    for name in in_file:
        matching = [name] if name in full_names else by_last_part.get(name, [])
        if len(matching) > 1:
            raise InputError(
                f"{poses}: {name} may be {matching[0]} or {matching[1]}; write the full names"
            )
        for match in matching:
            if match in names:
                raise InputError(
                    f"{poses}: {match} has two poses, {names[match]} and {name}: remove one"
                )
            names[match] = name
    return names
