"""Evaluation of one localizer on one data set."""

from __future__ import annotations

import logging
from contextlib import closing
from pathlib import Path

from benchmark.datasets.dataset import Dataset, Task
from benchmark.datasets.identity import describe_changes, require_unchanged
from benchmark.evaluation.run import Run, prepare_method
from benchmark.evaluation.starts import NONE, PRIOR, Start
from benchmark.report.album import ALBUM, ALBUM_MARK, album_parts, keep_album
from benchmark.report.pictures import median_query, query_overlay
from benchmark.results.query_result import QueryResult
from benchmark.results.results import DatasetId, Results
from benchmark.results.results_files import check_results_output, load
from objconnect.localization.pipeline.journal import Journal, journal_path
from objconnect.localization.provenance import Environment, Method
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Localizer
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.memory import peak_megabytes
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.answers import pose_of
from objconnect.scene.storage.digests import digest_of
from objconnect.scene.storage.outputs import OutputFile, check_outputs
from objconnect.scene.storage.provenance import PNG_MARK

log = logging.getLogger(__name__)


# More than six parameters: they are the options of the command ``evaluate``.
def evaluate(
    dataset: Dataset,
    localizer: Localizer,
    out: Path,
    start: Start = PRIOR,
    cache: Path | None = None,
    jobs: int = 1,
    cluster: str | None = None,
) -> Results:
    """Localize every query, score it, and write ``OUT/<dataset>/<method>.json`` at the end.

    Two files are written beside it: ``<method>-query.png``, the map drawn into the query of median
    error, and ``album.h5``, the pictures of each query for the leaderboard's page. If a method
    raises an exception on a query, that query counts as failed and the run goes on. A hidden
    journal keeps finished queries, so that an interrupted run goes on where it stopped. Queries
    that were finished on another version of the data set are not reused, and a warning names what
    changed. If the data set changes during the run, no results are written.

    Args:
        dataset: data set to run on.
        localizer: method to run.
        out: folder of the results.
        start: information on each query that the method gets besides its image.
        cache: folder for data that the method keeps per map; None for a scratch folder in ``out``.
        jobs: number of queries at a time, in threads. Seconds per query are measured with this many
            at work.
        cluster: address of a cluster whose cores localize the queries instead; see
            ``worker_pool``. Its nodes must see the data set and the cache under the same paths as
            this process. The preparation time is then that of the first worker, including its
            launch; the peak memory is that of the largest worker.

    Returns:
        The results that were written.

    Raises:
        InputError: the map or a photograph is missing, damaged or changed during the run, ``out``
            cannot be written, a file of another command would be replaced, or there is no such
            cluster.
    """
    require_folder(out)
    start = available_start(start, dataset)
    method = Method.of(localizer)
    target = results_path(out, dataset, localizer)
    check_evaluation_outputs(dataset, localizer, out)
    earlier = _read_earlier_results(target, DatasetId.of(dataset), method, start)
    # The nodes of a cluster need not see ``out``, so they make scratch folders of their own.
    run = Run(dataset, localizer, start, cache, None if cluster else out)
    key = _journal_key(method, dataset, start)
    with Journal(journal_path(target), key, QueryResult, dataset.parts) as journal:
        _warn_of_changes(dataset, target, earlier, journal)
        with (
            prepare_method(run, jobs, cluster) as (seconds, localize),
            closing(
                localize([q for q in dataset.queries if q.name not in journal.done], journal.add)
            ) as peak_memories,
            progress_bar(f"{dataset.name} {localizer.name}", len(dataset.queries)) as advance,
        ):
            peak = None if cluster else peak_megabytes()
            advance(len(journal.done))
            for memory in peak_memories:
                peak = max(filter(None, (peak, memory)), default=None)
                advance(len(journal.done))
        try:
            require_unchanged(dataset, run.sparse_map.names)
        except InputError:
            journal.done.clear()  # the queries may have been read before or after the change
            raise
        queries = [journal.done[query.name] for query in dataset.queries]
        results = Results.of(method, DatasetId.of(dataset), start.name, queries, seconds, peak)
        # The album comes before the results, so that a run interrupted here still has its journal.
        keep_album(target.with_name(ALBUM), dataset, run.sparse_map)
        results.write(target)
    _draw_median(dataset, run.sparse_map, results, _picture_path(target))
    return results


def _read_earlier_results(
    target: Path, dataset: DatasetId, method: Method, start: Start
) -> Results | None:
    """Return the results that a run will replace, or None.

    Log a warning if they are of the same data set, but of other options or another start.
    """
    if not target.is_file():
        return None
    try:
        earlier = load(target)
    except InputError:
        return None  # the file holds no results
    differences = [f"start {earlier.start}"] if earlier.start != start.name else []
    differences += ["other options or weights"] if earlier.method != method else []
    if differences and earlier.dataset == dataset:
        log.warning(
            "%s holds results with %s and will be replaced: choose another --out to keep both",
            target,
            " and ".join(differences),
        )
    return earlier


def _warn_of_changes(
    dataset: Dataset, target: Path, earlier: Results | None, journal: Journal[QueryResult]
) -> None:
    """Log which parts of the data set changed since an earlier run on it.

    The earlier run is the one of the journal, or else the one whose results are replaced.
    """
    path, before = journal.path, journal.dropped
    if before is None and earlier is not None:
        path, written = target, earlier.dataset.sha256
        if written != dataset.sha256:
            before = album_parts(target.with_name(ALBUM), written) or {}
    if before is None or before == dataset.parts:
        return
    changed = (
        describe_changes(before, dataset.parts)
        if before
        else "the earlier run did not record its parts"
    )
    log.warning("the data set %s changed since %s was written: %s", dataset.name, path, changed)


def require_folder(out: Path) -> None:
    """Refuse a path for results where a file lies.

    Raises:
        InputError: ``out`` exists and is not a folder.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"cannot write results to {out}: it is not a folder; choose another --out")


def results_path(out: Path, dataset: Dataset, localizer: Localizer) -> Path:
    """Return the path of the results of a method on a data set."""
    return out / dataset.name / f"{localizer.name}.json"


def _picture_path(results: Path) -> Path:
    """Return the path of the picture of the query of median error."""
    return results.with_name(f"{results.stem}-query.png")


def check_evaluation_outputs(dataset: Dataset, localizer: Localizer, out: Path) -> None:
    """Refuse, before any work, an evaluation whose files would replace files of another command.

    Raises:
        InputError: a file would be replaced, or cannot be written.
    """
    target = results_path(out, dataset, localizer)
    check_results_output(target, Method.of(localizer), out)
    picture = OutputFile(_picture_path(target), b"" if target.is_file() else PNG_MARK)
    check_outputs([picture, OutputFile(target.with_name(ALBUM), ALBUM_MARK)], within=out)


def available_start(start: Start, dataset: Task) -> Start:
    """Return the starting information; "none" for "prior" if no query of the data set has one."""
    if start.kind != "prior":
        return start
    missing = sum(query.prior is None for query in dataset.queries)
    if missing == len(dataset.queries):
        return NONE
    if missing:
        log.warning("%s: %d queries have no prior", dataset.name, missing)
    return PRIOR


def _journal_key(method: Method, dataset: Dataset, start: Start) -> str:
    """Return the digest of everything that determines the results of a run."""
    environment = Environment.current().model_dump_json()
    return digest_of(method.model_dump_json(), dataset.sha256, start.name, environment)


def _draw_median(dataset: Dataset, sparse_map: SparseMap, results: Results, path: Path) -> None:
    """Draw the query of median error; without a localized query there is no picture."""
    result = median_query(results.queries)
    if result is None or result.cam_from_world is None:
        return
    query = next(query for query in dataset.queries if query.name == result.name)
    query_overlay(query, sparse_map, pose_of(result.cam_from_world), path, results.method.name)
