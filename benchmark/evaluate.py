"""Runs one localizer over one data set."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import closing, contextmanager
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import Any

import torch

from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.datasets.identity import changes, require_unchanged
from benchmark.journal import Journal, journal_path
from benchmark.registry import create, known
from benchmark.report.album import ALBUM, ALBUM_MARK, album_parts, keep_album
from benchmark.report.pictures import median_query, query_overlay
from benchmark.results import (
    LARGEST_NEES,
    TOTAL,
    DatasetId,
    Environment,
    Method,
    PoseNumbers,
    QueryResult,
    Results,
    claim_results,
    load,
)
from benchmark.starts import NONE, PRIOR, Ask, Start
from benchmark.uncertainty import normalised_error
from scene.errors import InputError
from scene.geometry.pose import FARTHEST_M, Pose
from scene.localizer import Estimate, Localizer, Query, Status
from scene.maps.sparse_map import SparseMap
from scene.runtime.cluster import shares, worker_pool
from scene.runtime.memory import peak_megabytes, reset_peak
from scene.runtime.progress import progress_bar
from scene.storage.marks import PNG_MARK
from scene.storage.outputs import Output, claim
from scene.storage.scratch import kept_or_scratch

log = logging.getLogger(__name__)

# Queries that a worker of a cluster is handed at once, at most.
_UNIT = 16


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

    Beside it go ``<method>-query.png``, the map drawn into the query of median error, and
    ``album.h5``, what the page shows of each query. A method that raises an exception on a query
    has failed on that query, and the run goes on. Finished queries are kept in a hidden journal
    until then: the same run, interrupted, goes on there. What was finished on another data set is
    not taken, and a line of the log says what changed; nothing is written of a data set that
    changes during the run.

    Args:
        dataset: what to run on.
        localizer: what to run.
        out: folder of the results.
        start: what the method is told about each query besides its image.
        cache: folder for the method's per-map state; None for a scratch folder in ``out``.
        jobs: queries at a time, in threads. Seconds per query are those of one of so many.
        cluster: whose cores answer instead, a query each, see ``worker_pool``. Its
            nodes see data set and cache under the paths they have here. Seconds of preparation are
            then those of the first worker, its own start included; memory is the largest worker's.

    Raises:
        InputError: the map or a photograph is missing, broken or changed meanwhile, ``out`` cannot
            be written, or there is no such cluster.
    """
    require_folder(out)
    start = _given(start, dataset)
    method = method_of(localizer)
    target = results_path(out, dataset, localizer)
    claim_evaluation(dataset, localizer, out)
    # Nodes of a cluster need not see ``out``.
    run = _Run(dataset, localizer, start, cache, None if cluster else out)
    key = _key(method, dataset, start)
    with Journal(journal_path(target), key, QueryResult, dataset.parts) as journal:
        _say_what_changed(dataset, target, journal)
        with (
            _answering(run, jobs, cluster) as (prepare, ask),
            closing(ask([q for q in dataset.queries if q.name not in journal.done])) as answers,
            progress_bar(f"{dataset.name} {localizer.name}", len(dataset.queries)) as advance,
        ):
            peak = None if cluster else peak_megabytes()
            advance(len(journal.done))
            for result, memory in answers:
                journal.add(result)
                peak = max(filter(None, (peak, memory)), default=None)
                advance(len(journal.done))
        try:
            require_unchanged(dataset, run.sparse_map.names)
        except InputError:
            journal.done.clear()  # nobody knows which bytes they are of
            raise
        queries = [journal.done[query.name] for query in dataset.queries]
        results = Results.of(method, identity(dataset), start.name, queries, prepare, peak)
        # Before the results, so that a run interrupted here has lost nothing.
        keep_album(target.with_name(ALBUM), dataset, run.sparse_map)
        results.write(target)
    _draw_median(dataset, run.sparse_map, results, _picture(target))
    return results


_Answer = tuple[QueryResult, float | None]
"""Of a query, and the largest memory of its process so far, 1e6 bytes."""
_Ask = Callable[[Sequence[BenchmarkQuery]], Generator[_Answer, None, None]]


class _Run:
    """A method at work on a data set.

    Before it is prepared it goes to workers, who make a method we know anew by its name and
    configuration: libraries' own objects in it cannot travel.
    """

    def __init__(
        self,
        dataset: Dataset,
        localizer: Localizer,
        start: Start,
        cache: Path | None,
        beside: Path | None,
    ) -> None:
        self._dataset, self._localizer = dataset, localizer
        self._start, self._cache, self._beside = start, cache, beside
        self._ask: Ask | None = None

    def __getstate__(self) -> dict[str, Any]:
        localizer = self._localizer
        if localizer.name not in known():
            return self.__dict__
        recipe = (localizer.name, localizer.config.model_dump())
        return self.__dict__ | {"_localizer": None, "_recipe": recipe}

    def __setstate__(self, state: dict[str, Any]) -> None:
        recipe = state.pop("_recipe", None)
        self.__dict__.update(state)
        if recipe is not None:
            self._localizer = create(*recipe)

    @cached_property
    def sparse_map(self) -> SparseMap:
        """Of the data set."""
        return self._dataset.load_map()

    def prepare(self) -> float:
        """Make the method ready; seconds it took."""
        reset_peak()
        sparse_map = self.sparse_map
        # What is prepared stays open.
        with kept_or_scratch(self._cache, self._beside) as cache:
            began = perf_counter()
            self._localizer.prepare(sparse_map, self._dataset.images, cache)
            took = perf_counter() - began
            self._ask = self._start.asker(self._dataset, sparse_map, cache)
        return took

    def answer(self, query: BenchmarkQuery) -> _Answer:
        """Ask, and score."""
        assert self._ask is not None
        loaded = self._ask(query)
        began = perf_counter()
        estimate = localize_safely(self._localizer, loaded)
        return score_query(
            query, estimate, self.sparse_map, perf_counter() - began
        ), peak_megabytes()

    def __call__(self, queries: Sequence[BenchmarkQuery]) -> Iterator[_Answer]:
        """What a worker of a crew does."""
        if self._ask is None:
            self.prepare()
        yield from map(self.answer, queries)


@contextmanager
def _answering(run: _Run, jobs: int, cluster: str | None) -> Iterator[tuple[float, _Ask]]:
    """Seconds that preparing took, and who answers queries: our threads, or a cluster."""
    if cluster is None:
        yield run.prepare(), lambda queries: _in_threads(run, queries, jobs)
        return
    with worker_pool(cluster, run) as workers:
        began = perf_counter()
        for _ in workers.map([()]):  # one fills the cache, from which the others take it
            pass
        took = perf_counter() - began
        yield took, lambda queries: workers.map(shares(queries, workers.cores, 1, _UNIT))


def _in_threads(
    run: _Run, queries: Sequence[BenchmarkQuery], jobs: int
) -> Generator[_Answer, None, None]:
    with ThreadPoolExecutor(jobs) as pool:
        try:
            order = {pool.submit(run.answer, query): k for k, query in enumerate(queries)}
            waiting = set(order)
            while waiting:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                # What came first ends the run first, when it is an error.
                for future in sorted(done, key=order.__getitem__):
                    yield future.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _say_what_changed(dataset: Dataset, target: Path, journal: Journal[QueryResult]) -> None:
    """Name what of the data set is not as it was when the journal, or else the results that are
    replaced, were written."""
    path, before = journal.path, journal.dropped
    if before is None and target.is_file():
        path = target
        try:
            written = load(target).dataset.sha256
        except InputError:
            return  # no results
        if written != dataset.sha256:
            before = album_parts(target.with_name(ALBUM), written) or {}
    if before is None or before == dataset.parts:
        return
    changed = changes(before, dataset.parts) if before else "which part was not recorded"
    log.warning("the data set %s changed since %s was written: %s", dataset.name, path, changed)


def require_folder(out: Path) -> None:
    """InputError: something that is no folder stands where results are to go."""
    if out.exists() and not out.is_dir():
        raise InputError(f"cannot write results to {out}: it is not a folder")


def results_path(out: Path, dataset: Dataset, localizer: Localizer) -> Path:
    """Where the results of a method on a data set lie."""
    return out / dataset.name / f"{localizer.name}.json"


def _picture(results: Path) -> Path:
    """Of the query of median error."""
    return results.with_name(f"{results.stem}-query.png")


def claim_evaluation(dataset: Dataset, localizer: Localizer, out: Path) -> None:
    """Refuse, before any work, an evaluation whose files would replace somebody else's.

    Raises:
        InputError: they would, or cannot be written.
    """
    target = results_path(out, dataset, localizer)
    claim_results(target, method_of(localizer), out)
    drawn = Output(_picture(target), b"" if target.is_file() else PNG_MARK)
    claim([drawn, Output(target.with_name(ALBUM), ALBUM_MARK)], within=out)


def method_of(localizer: Localizer) -> Method:
    """What results say of their method."""
    return Method(
        name=localizer.name,
        config=localizer.config.model_dump(mode="json"),
        weights_sha256=localizer.weights_sha256,
    )


def _given(start: Start, dataset: Dataset) -> Start:
    """The start as it is: a data set without priors has none to give."""
    if start.kind != "prior":
        return start
    given = sum(query.prior is not None for query in dataset.queries)
    if 0 < given < len(dataset.queries):
        missing = len(dataset.queries) - given
        log.warning("%s: %d queries have no prior", dataset.name, missing)
    return PRIOR if given else NONE


def _key(method: Method, dataset: Dataset, start: Start) -> str:
    """Digest of everything that decides the results of a run."""
    parts = [method.model_dump_json(), dataset.sha256, start.name]
    parts.append(Environment.current().model_dump_json())
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def identity(dataset: Dataset) -> DatasetId:
    """What results say of their data set."""
    return DatasetId(
        name=dataset.name,
        track=dataset.track,
        sha256=dataset.sha256,
        map_conditions=dataset.map_conditions,
    )


def localize_safely(localizer: Localizer, query: Query) -> Estimate:
    """The method's answer; a crash or a pose that is none is a failure with a reason."""
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
    """An estimate held against the reference pose of its query; seconds where they are known."""
    pose = estimate.cam_from_world if estimate.status is not Status.FAILED else None
    numbers = t_err = r_err = nees = None
    if pose is not None:
        pose = pose.to(dtype=torch.float64, device=torch.device("cpu"))
        numbers = (*pose.quaternion().tolist(), *pose.translation.tolist())
        # What is scored is what is written.
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
        # A covariance beyond all bounds says as little as none.
        sigma_t_m=sigma if sigma is not None and sigma <= FARTHEST_M else None,
        nees=nees,
        iterations=estimate.iterations,
        inliers=estimate.inliers,
        seconds=estimate.seconds | ({} if seconds is None else {TOTAL: seconds}),
    )


def _draw_median(dataset: Dataset, sparse_map: SparseMap, results: Results, path: Path) -> None:
    """The query of median error; no picture when no query has a pose."""
    chosen = median_query(results.queries)
    if chosen is None or chosen.cam_from_world is None:
        return
    query = next(query for query in dataset.queries if query.name == chosen.name)
    query_overlay(query, sparse_map, _pose(chosen.cam_from_world), path, results.method.name)


def _pose(numbers: PoseNumbers) -> Pose:
    return Pose.from_quaternion(numbers[:4], numbers[4:])
