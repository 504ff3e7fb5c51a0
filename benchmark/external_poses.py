"""``score``: poses that another program found, held against a data set's references."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from benchmark.datasets.dataset import Dataset
from benchmark.datasets.textfiles import read_poses
from benchmark.evaluate import identity, score_query
from benchmark.results import BASIN, Method, Results, claim_results
from benchmark.starts import parse_start
from scene.errors import InputError
from scene.localizer import Estimate, Status
from scene.storage.files import sha256_of
from scene.storage.outputs import require_name


def score(
    poses: Path, datasets: Sequence[Dataset], method: str, out: Path, start: str = "none"
) -> list[Path]:
    """Score a file of poses in the format of hloc, ``name qw qx qy qz tx ty tz``, world to camera,
    and write ``OUT/<dataset>/<method>.json``.

    Results of the same name are replaced only if they are of this command.

    A query without a line counts as failed. Names may be those of the data set or, where that is
    not ambiguous, their last part, as hloc writes them for Aachen.

    Args:
        poses: text file.
        datasets: those whose queries the file may hold.
        method: name to go by in the results, and theirs.
        out: folder of the results.
        start: what the method was told: see ``benchmark.starts.parse_start``.

    Returns:
        The results files; of a data set none of whose queries is in the file there is none.

    Raises:
        InputError: unreadable file, a pose of no query, a query with two, a method whose name
            cannot name a file, or results that this command did not write.
    """
    require_name(method, "method")
    if f"{method}.json".endswith(BASIN):
        raise InputError(f"method {method!r}: files that end in {BASIN} are of basins")
    told = parse_start(start)
    found = read_poses(poses)
    digest = sha256_of(poses)
    left = set(found)
    results: dict[Path, Results] = {}
    for dataset in datasets:
        names = _named(found, dataset, poses)
        if not names:
            continue
        left -= set(names.values())
        sparse_map = dataset.load_map()
        queries = []
        for query in dataset.queries:
            if query.name in names:
                estimate = Estimate(Status.OK, found[names[query.name]])
            else:
                estimate = Estimate(Status.FAILED, reason=f"no line in {poses.name}")
            queries.append(score_query(query, estimate, sparse_map, None))
        made_by = Method.external(method, digest)
        target = out / dataset.name / f"{method}.json"
        claim_results(target, made_by, out)
        results[target] = Results.of(made_by, identity(dataset), told.name, queries)
    if left:
        raise InputError(
            f"{poses}: {len(left)} poses are of no query of the reference, such as {min(left)}"
        )
    if not results:
        raise InputError(f"{poses} holds no pose")
    for target, scores in results.items():
        scores.write(target)
    return list(results)


def _named(found: Collection[str], dataset: Dataset, poses: Path) -> dict[str, str]:
    """Name in the file of each query that has a line."""
    short: dict[str, list[str]] = {}
    for query in dataset.queries:
        short.setdefault(Path(query.name).name, []).append(query.name)
    names: dict[str, str] = {}
    whole = {query.name for query in dataset.queries}
    for name in found:
        matching = [name] if name in whole else short.get(name, [])
        if len(matching) > 1:
            raise InputError(
                f"{poses}: {name} may be {matching[0]} or {matching[1]}; write whole names"
            )
        for match in matching:
            if match in names:
                raise InputError(f"{poses}: {match} has two poses, {names[match]} and {name}")
            names[match] = name
    return names
