"""Evaluation of one localizer on one data set.

The module is over 400 lines because the run, its workers and its files are interrupted, resumed and
checked together.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import closing, contextmanager
from functools import cached_property, partial
from pathlib import Path
from threading import Event
from time import perf_counter
from typing import Any

import torch

from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.datasets.identity import changes, require_unchanged
from benchmark.journal import Journal, journal_path
from benchmark.query_result import LARGEST_NEES, TOTAL, PoseNumbers, QueryResult
from benchmark.registry import create, known
from benchmark.report.album import ALBUM, ALBUM_MARK, album_parts, keep_album
from benchmark.report.pictures import median_query, query_overlay
from benchmark.results import DatasetId, Environment, Method, Results
from benchmark.results_files import claim_results, load
from benchmark.starts import NONE, PRIOR, LoadQuery, Start
from benchmark.uncertainty import normalised_error
from scene.errors import InputError
from scene.geometry.geodesy import FARTHEST_M
from scene.geometry.pose import Pose
from scene.localizer import Estimate, Localizer, Query, Status
from scene.maps.sparse_map import SparseMap
from scene.runtime.cluster import WorkerPool, split_work, worker_pool
from scene.runtime.memory import peak_megabytes, reset_peak
from scene.runtime.progress import progress_bar
from scene.storage.outputs import OutputFile, check_outputs
from scene.storage.provenance import PNG_MARK
from scene.storage.scratch import cache_or_scratch

log = logging.getLogger(__name__)

# The greatest number of queries that a worker of a cluster is handed at once.
_MOST_QUERIES_AT_ONCE = 16
# Work without a query: a worker that is handed it only prepares the method.
_ONLY_PREPARE: Sequence[BenchmarkQuery] = ()


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

    Two files are written beside it: ``<method>-query.png``, which shows the map drawn into the
    query of median error, and ``album.h5``, which holds what the leaderboard's page shows of each
    query. Where a method raises an exception on a query, it has failed on that query, and the run
    goes on. Finished queries are kept in a hidden journal until the run ends, so that an
    interrupted run goes on where it stopped. Queries that were finished on another version of the
    data set are not reused, and a warning names what changed. If the data set changes during the
    run, no results are written.

    Args:
        dataset: data set to run on.
        localizer: method to run.
        out: folder of the results.
        start: what the method is told about each query besides its image.
        cache: folder for what the method keeps per map; None for a scratch folder in ``out``.
        jobs: number of queries at a time, in threads. Seconds per query are measured with this many
            at work.
        cluster: address of a cluster whose cores localize the queries instead; see
            ``worker_pool``. Its nodes must see the data set and the cache under the same paths as
            this process. The seconds of preparation are then those of the first worker, with its
            own start; the peak memory is that of the largest worker.

    Returns:
        The results that were written.

    Raises:
        InputError: the map or a photograph is missing, damaged or changed during the run, ``out``
            cannot be written, or there is no such cluster.
    """
    require_folder(out)
    start = _available_start(start, dataset)
    method = method_of(localizer)
    target = results_path(out, dataset, localizer)
    claim_evaluation(dataset, localizer, out)
    # The nodes of a cluster need not see ``out``, so they make scratch folders of their own.
    run = _Run(dataset, localizer, start, cache, None if cluster else out)
    key = _key(method, dataset, start)
    with Journal(journal_path(target), key, QueryResult, dataset.parts) as journal:
        _warn_of_changes(dataset, target, journal)
        with (
            _prepared(run, jobs, cluster) as (seconds, localize),
            closing(
                localize([q for q in dataset.queries if q.name not in journal.done], journal.add)
            ) as scored,
            progress_bar(f"{dataset.name} {localizer.name}", len(dataset.queries)) as advance,
        ):
            peak = None if cluster else peak_megabytes()
            advance(len(journal.done))
            for memory in scored:
                peak = max(filter(None, (peak, memory)), default=None)
                advance(len(journal.done))
        try:
            require_unchanged(dataset, run.sparse_map.names)
        except InputError:
            journal.done.clear()  # the queries may have been read before or after the change
            raise
        queries = [journal.done[query.name] for query in dataset.queries]
        results = Results.of(method, identity(dataset), start.name, queries, seconds, peak)
        # The album comes before the results, so that a run interrupted here still has its journal.
        keep_album(target.with_name(ALBUM), dataset, run.sparse_map)
        results.write(target)
    _draw_median(dataset, run.sparse_map, results, _picture_path(target))
    return results


_Scored = tuple[QueryResult, float | None]
"""The result of a query, and the peak memory of its process so far (1e6 bytes; None if unknown)."""
_Keep = Callable[[QueryResult], None]
"""Keeps the result of a query. Threads call it: no signal parts an answer from its keeping."""
_LocalizeAll = Callable[[Sequence[BenchmarkQuery], _Keep], Generator[float | None, None, None]]


class _Run:
    """A method that is prepared on the map of a data set and localizes its queries.

    An unprepared run can be pickled, so that the workers of a cluster prepare one each.
    """

    def __init__(
        self,
        dataset: Dataset,
        localizer: Localizer,
        start: Start,
        cache: Path | None,
        scratch: Path | None,
    ) -> None:
        self._dataset, self._localizer = dataset, localizer
        self._start, self._cache, self._scratch = start, cache, scratch
        self._load: LoadQuery | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle an unprepared run.

        A localizer of the registry is pickled as its name and configuration, because objects of
        libraries inside it cannot be pickled.
        """
        localizer: Any = self._localizer
        if localizer.name in known():
            return _created_run, (
                self._dataset, localizer.name, localizer.config.model_dump(), self._start,
                self._cache, self._scratch,
            )  # fmt: skip
        return _Run, (self._dataset, localizer, self._start, self._cache, self._scratch)

    @cached_property
    def sparse_map(self) -> SparseMap:
        """Return the map of the data set."""
        return self._dataset.load_map()

    def prepare(self) -> float:
        """Prepare the method on the map, and return the seconds that the method took."""
        reset_peak()
        sparse_map = self.sparse_map
        # Files that the method opened in the folder stay open after the folder is gone.
        with cache_or_scratch(self._cache, self._scratch) as cache:
            began = perf_counter()
            self._localizer.prepare(sparse_map, self._dataset.images, cache)
            took = perf_counter() - began
            self._load = self._start.loader(self._dataset, sparse_map, cache)
        return took

    def localize(self, query: BenchmarkQuery) -> _Scored:
        """Localize a query and score its pose."""
        assert self._load is not None
        loaded = self._load(query)
        began = perf_counter()
        estimate = localize_safely(self._localizer, loaded)
        seconds = perf_counter() - began
        return score_query(query, estimate, self.sparse_map, seconds), peak_megabytes()

    def __call__(self, queries: Sequence[BenchmarkQuery]) -> Iterator[_Scored]:
        """Localize queries in a worker, which prepares the method before its first queries."""
        if self._load is None:
            self.prepare()
        yield from map(self.localize, queries)


def _created_run(dataset: Dataset, name: str, config: dict[str, Any], *others: Any) -> _Run:
    return _Run(dataset, create(name, config), *others)


@contextmanager
def _prepared(run: _Run, jobs: int, cluster: str | None) -> Iterator[tuple[float, _LocalizeAll]]:
    """Prepare the method here or on a cluster.

    Yields:
        The seconds that preparing took, and a function that localizes queries in threads of this
        process or on the cluster, keeps each result, and yields the peak memory of its process.
    """
    if cluster is None:
        yield run.prepare(), lambda queries, keep: _in_threads(run, queries, jobs, keep)
        return
    with worker_pool(cluster, run) as workers:
        yield _prepare_one_worker(workers), partial(_on_cluster, workers)


def _on_cluster(
    workers: WorkerPool[Sequence[BenchmarkQuery], _Scored],
    queries: Sequence[BenchmarkQuery],
    keep: _Keep,
) -> Generator[float | None, None, None]:
    parts = split_work(queries, workers.cores, 1, _MOST_QUERIES_AT_ONCE)
    with closing(workers.map(parts)) as answers:
        for result, memory in answers:
            keep(result)
            yield memory


def _prepare_one_worker(workers: WorkerPool[Sequence[BenchmarkQuery], _Scored]) -> float:
    """Let one worker prepare the method, and return the seconds that it took.

    This fills the cache, which the other workers then read instead of preparing all at once.
    """
    began = perf_counter()
    nothing = list(workers.map([_ONLY_PREPARE]))
    assert not nothing
    return perf_counter() - began


def _in_threads(
    run: _Run, queries: Sequence[BenchmarkQuery], jobs: int, keep: _Keep
) -> Generator[float | None, None, None]:
    """Localize queries in threads, and yield the peak memory as soon as a result is kept."""
    failed = Event()

    def localize(query: BenchmarkQuery) -> float | None:
        if failed.is_set():
            return None
        try:
            result, memory = run.localize(query)
            keep(result)
        except BaseException:
            failed.set()
            raise
        return memory

    with ThreadPoolExecutor(jobs) as pool:
        try:
            order = {pool.submit(localize, query): k for k, query in enumerate(queries)}
            waiting = set(order)
            while waiting:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                # Of several errors at once, the one of the earliest query ends the run.
                for future in sorted(done, key=order.__getitem__):
                    yield future.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _warn_of_changes(dataset: Dataset, target: Path, journal: Journal[QueryResult]) -> None:
    """Log which parts of the data set changed since an earlier run on it.

    The earlier run is the one of the journal, or else the one whose results are replaced.
    """
    path, before = journal.path, journal.dropped
    if before is None and target.is_file():
        path = target
        try:
            written = load(target).dataset.sha256
        except InputError:
            return  # the file holds no results
        if written != dataset.sha256:
            before = album_parts(target.with_name(ALBUM), written) or {}
    if before is None or before == dataset.parts:
        return
    changed = changes(before, dataset.parts) if before else "which part was not recorded"
    log.warning("the data set %s changed since %s was written: %s", dataset.name, path, changed)


def require_folder(out: Path) -> None:
    """Refuse a path for results where a file lies.

    Raises:
        InputError: ``out`` exists and is not a folder.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"cannot write results to {out}: it is not a folder")


def results_path(out: Path, dataset: Dataset, localizer: Localizer) -> Path:
    """Return the path of the results of a method on a data set."""
    return out / dataset.name / f"{localizer.name}.json"


def _picture_path(results: Path) -> Path:
    """Return the path of the picture of the query of median error."""
    return results.with_name(f"{results.stem}-query.png")


def claim_evaluation(dataset: Dataset, localizer: Localizer, out: Path) -> None:
    """Refuse, before any work, an evaluation whose files would replace files of another command.

    Raises:
        InputError: a file would be replaced, or cannot be written.
    """
    target = results_path(out, dataset, localizer)
    claim_results(target, method_of(localizer), out)
    picture = OutputFile(_picture_path(target), b"" if target.is_file() else PNG_MARK)
    check_outputs([picture, OutputFile(target.with_name(ALBUM), ALBUM_MARK)], within=out)


def method_of(localizer: Localizer) -> Method:
    """Return what results record of their method."""
    return Method(
        name=localizer.name,
        config=localizer.config.model_dump(mode="json"),
        weights_sha256=localizer.weights_sha256,
    )


def _available_start(start: Start, dataset: Dataset) -> Start:
    """Return the start, or "none" where it is "prior" and no query of the data set has a prior."""
    if start.kind != "prior":
        return start
    missing = sum(query.prior is None for query in dataset.queries)
    if missing == len(dataset.queries):
        return NONE
    if missing:
        log.warning("%s: %d queries have no prior", dataset.name, missing)
    return PRIOR


def _key(method: Method, dataset: Dataset, start: Start) -> str:
    """Return the digest of everything that decides the results of a run."""
    parts = [method.model_dump_json(), dataset.sha256, start.name]
    parts.append(Environment.current().model_dump_json())
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def identity(dataset: Dataset) -> DatasetId:
    """Return what results record of their data set."""
    return DatasetId(
        name=dataset.name,
        track=dataset.track,
        sha256=dataset.sha256,
        map_conditions=dataset.map_conditions,
    )


def localize_safely(localizer: Localizer, query: Query) -> Estimate:
    """Localize a query, where an exception of the method counts as a failure.

    A pose that is missing, not finite or too far away is a failure, too. The estimate then has the
    status ``FAILED`` and states the reason.

    Raises:
        InputError: the method cannot read its input.
    """
    try:
        estimate = localizer.localize(query)
    except InputError:
        raise
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        log.warning("%s failed on %s: %s", localizer.name, query.name, " ".join(reason.split()))
        return Estimate(Status.FAILED, reason=reason)
    if estimate.status is Status.FAILED:
        return estimate
    if estimate.cam_from_world is None:
        return Estimate(Status.FAILED, reason=f"answered '{estimate.status}' without a pose")
    matrix = estimate.cam_from_world.matrix()
    if not bool(matrix.isfinite().all()):
        return Estimate(Status.FAILED, reason="the pose is not finite")
    if bool((matrix.abs() > FARTHEST_M).any()):
        return Estimate(Status.FAILED, reason=f"the pose is more than {FARTHEST_M:g} m away")
    return estimate


def score_query(
    query: BenchmarkQuery, estimate: Estimate, sparse_map: SparseMap, seconds: float | None
) -> QueryResult:
    """Compare an estimate with the reference pose of its query.

    Args:
        query: query with its reference pose.
        estimate: answer of a method.
        sparse_map: map, for the height of the query above its points.
        seconds: wall-clock time of the method's call; None where it was not measured.
    """
    pose = estimate.cam_from_world if estimate.status is not Status.FAILED else None
    numbers = t_err = r_err = nees = None
    if pose is not None:
        pose = pose.to(dtype=torch.float64, device=torch.device("cpu"))
        numbers = (*pose.quaternion().tolist(), *pose.translation.tolist())
        # The pose is scored as it is written to the file, so that the figures can be recomputed.
        metres, degrees = _pose(numbers).error_to(query.reference)
        t_err, r_err = float(metres), float(degrees)
        nees = normalised_error(_pose(numbers), query.reference, estimate.covariance)
        nees = None if nees is None else min(nees, LARGEST_NEES)
    sigma = estimate.sigma_position()
    return QueryResult(
        name=query.name,
        condition=query.condition,
        group=query.group,
        altitude_m=sparse_map.height_above(query.reference.centre().numpy()),
        status=estimate.status,
        reason=estimate.reason,
        t_err_m=t_err,
        r_err_deg=r_err,
        cam_from_world=numbers,
        # A covariance larger than any scene carries no information.
        sigma_t_m=sigma if sigma is not None and sigma <= FARTHEST_M else None,
        nees=nees,
        iterations=estimate.iterations,
        inliers=estimate.inliers,
        seconds=estimate.seconds | ({} if seconds is None else {TOTAL: seconds}),
    )


def _draw_median(dataset: Dataset, sparse_map: SparseMap, results: Results, path: Path) -> None:
    """Draw the query of median error; without a localized query there is no picture."""
    chosen = median_query(results.queries)
    if chosen is None or chosen.cam_from_world is None:
        return
    query = next(query for query in dataset.queries if query.name == chosen.name)
    query_overlay(query, sparse_map, _pose(chosen.cam_from_world), path, results.method.name)


def _pose(numbers: PoseNumbers) -> Pose:
    return Pose.from_quaternion(numbers[:4], numbers[4:])
