"""The command ``score``, which scores the poses that another program estimated."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from benchmark.datasets.dataset import Dataset
from benchmark.evaluation.scored_query import score_query
from benchmark.evaluation.starts import parse_start
from benchmark.results.results import DatasetId, Results
from benchmark.results.results_files import BASIN, claim_results
from objconnect.localization.provenance import Method
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import read_poses
from objconnect.scene.localizer import Estimate, Status
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
        start: what the method was told, see ``starts.parse_start``. Nothing verifies it,
            and tables print it "as declared".

    Returns:
        The results files that were written: one for each data set with a query in the file.

    Raises:
        InputError: the file cannot be read, a pose belongs to no query, a query has two poses, the
            method cannot name a file, or results there are from another command.
    """
    require_name(method, "method")
    if f"{method}.json".endswith(BASIN):
        raise InputError(f"method {method!r}: the ending {BASIN} is reserved for basin files")
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
        sparse_map = dataset.load_map()
        queries = []
        for query in dataset.queries:
            if query.name in names:
                estimate = Estimate(Status.OK, pose_of[names[query.name]])
            else:
                estimate = Estimate(Status.FAILED, reason=f"no line in {poses.name}")
            queries.append(score_query(query, estimate, sparse_map, None))
        made_by = Method.external(method, digest)
        target = out / dataset.name / f"{method}.json"
        claim_results(target, made_by, out)
        results[target] = Results.of(
            made_by, DatasetId.of(dataset), starting_information.name, queries
        )
    if unused:
        raise InputError(
            f"{poses}: {len(unused)} poses belong to no query of the data sets, such as "
            f"{min(unused)}"
        )
    if not results:
        raise InputError(f"{poses} contains no pose")
    for target, scores in results.items():
        scores.write(target)
    return list(results)


def _match_names(in_file: Collection[str], dataset: Dataset, poses: Path) -> dict[str, str]:
    """Return the name in the file by the name of the query, for queries that have a line."""
    short: dict[str, list[str]] = {}
    for query in dataset.queries:
        short.setdefault(Path(query.name).name, []).append(query.name)
    names: dict[str, str] = {}
    whole = {query.name for query in dataset.queries}
    for name in in_file:
        matching = [name] if name in whole else short.get(name, [])
        if len(matching) > 1:
            raise InputError(
                f"{poses}: {name} may be {matching[0]} or {matching[1]}; write the full names"
            )
        for match in matching:
            if match in names:
                raise InputError(f"{poses}: {match} has two poses, {names[match]} and {name}")
            names[match] = name
    return names
