"""A run of a method on the queries of a data set, in threads of this process or on a cluster."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import cached_property, partial
from pathlib import Path
from time import perf_counter
from typing import Any

from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.evaluation.scored_query import score_query
from benchmark.evaluation.starts import LoadQuery, Start
from benchmark.results.query_result import QueryResult
from objconnect.localization.pipeline.failures import localize_safely
from objconnect.methods import create, method_names
from objconnect.scene.localizer import Localizer, MapPart, PreparesParts
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.cluster import WorkerPool, split_work, worker_pool
from objconnect.scene.runtime.memory import peak_megabytes, reset_peak
from objconnect.scene.runtime.threads import map_unordered
from objconnect.scene.storage.scratch import cache_or_scratch, scratch

# A worker of a cluster gets at most this many queries at once.
_MOST_QUERIES_AT_ONCE = 16
# Smallest and largest number of map photographs that a worker prepares at once.
_FEWEST_PREPARED, _MOST_PREPARED = 8, 64
# Work without a query: a worker only prepares the method.
_ONLY_PREPARE: Sequence[BenchmarkQuery] = ()

ResultAndMemory = tuple[QueryResult, float | None]
"""The result of a query, and the peak memory of its process so far (1e6 bytes; None if unknown)."""
StoreResult = Callable[[QueryResult], None]
"""Stores the result of a query. Without a cluster, worker threads call it, so that no signal
interrupts between localizing a query and storing its result."""
Unit = Sequence[BenchmarkQuery] | MapPart
"""Work for a worker of a cluster: queries to localize, or a part of the map to prepare."""
LocalizeAll = Callable[[Sequence[BenchmarkQuery], StoreResult], Generator[float | None, None, None]]
"""Localizes queries, stores each result, and yields the peak memory of its process (1e6 bytes)."""


class Run:
    """A method on a data set: prepares the map and localizes queries.

    An unprepared run can be pickled, so that each worker of a cluster prepares its own.
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

        A registered localizer is pickled as its name and configuration, because it may hold objects
        of libraries that cannot be pickled.
        """
        localizer: Any = self._localizer
        if localizer.name in method_names():
            return _create_run, (
                self._dataset, localizer.name, localizer.config.model_dump(), self._start,
                self._cache, self._scratch,
            )  # fmt: skip
        return Run, (self._dataset, localizer, self._start, self._cache, self._scratch)

    @cached_property
    def sparse_map(self) -> SparseMap:
        """The map of the data set."""
        return self._dataset.load_map()

    def prepare(self) -> float:
        """Prepare the method on the map, and return the seconds that the method took."""
        reset_peak()
        sparse_map = self.sparse_map
        # Files that the method opened in the folder stay open after the folder is gone.
        with cache_or_scratch(self._cache, self._scratch) as cache:
            began = perf_counter()
            self._localizer.prepare(sparse_map, self._dataset.images, cache)
            seconds = perf_counter() - began
            self._load = self._start.loader(self._dataset, sparse_map, cache)
        return seconds

    def localize(self, query: BenchmarkQuery) -> ResultAndMemory:
        """Localize a query and score its pose."""
        assert self._load is not None
        loaded = self._load(query)
        began = perf_counter()
        estimate = localize_safely(self._localizer, loaded)
        seconds = perf_counter() - began
        course = self._dataset.courses[query.group]
        scored = score_query(query, course, estimate, self.sparse_map, seconds, loaded.prior)
        return scored, peak_megabytes()

    def __call__(self, unit: Unit) -> Iterator[ResultAndMemory]:
        """Localize queries in a worker, after preparing the method once; or compute the cache of a
        part of the map and yield nothing."""
        if isinstance(unit, MapPart):
            assert isinstance(self._localizer, PreparesParts) and self._cache is not None
            images = self._dataset.images
            self._localizer.prepare_part(self.sparse_map, images, self._cache, unit)
            return
        if self._load is None:
            self.prepare()
        yield from map(self.localize, unit)

    @contextmanager
    def parts(self, cores: int) -> Iterator[Sequence[MapPart]]:
        """Divide the preparation among the cores of a cluster, if the method supports parts.

        The files of the parts exist while the ``with`` block runs, in which a worker prepares the
        whole map from them.
        """
        if self._cache is None or not isinstance(self._localizer, PreparesParts):
            yield []
            return
        names = self.sparse_map.names
        with scratch(self._cache) as folder:
            parts = split_work(names, cores, _FEWEST_PREPARED, _MOST_PREPARED)
            yield [MapPart(part, folder.absolute()) for part in parts]


def _create_run(dataset: Dataset, name: str, config: dict[str, Any], *others: Any) -> Run:
    return Run(dataset, create(name, config), *others)


@contextmanager
def prepare_method(run: Run, jobs: int, cluster: str | None) -> Iterator[tuple[float, LocalizeAll]]:
    """Prepare the method here or on a cluster.

    Yields:
        The preparation time in seconds, and a function that localizes queries, stores each result,
        and yields the peak memory of the process that localized it.
    """
    if cluster is None:
        yield run.prepare(), lambda queries, store: _localize_in_threads(run, queries, jobs, store)
        return
    with worker_pool(cluster, run) as workers:
        yield _prepare_workers(run, workers), partial(_localize_on_cluster, workers)


def _localize_on_cluster(
    workers: WorkerPool[Unit, ResultAndMemory],
    queries: Sequence[BenchmarkQuery],
    store: StoreResult,
) -> Generator[float | None, None, None]:
    parts = split_work(queries, workers.cores, 1, _MOST_QUERIES_AT_ONCE)
    with closing(workers.map(parts)) as answers:
        for result, memory in answers:
            store(result)
            yield memory


def _prepare_workers(run: Run, workers: WorkerPool[Unit, ResultAndMemory]) -> float:
    """Prepare the map in parts on all workers, then whole on one; return the time in seconds.

    This fills the cache, so that the other workers read it instead of preparing the same again.
    """
    began = perf_counter()
    with run.parts(workers.cores) as parts:
        results = [*workers.map(parts), *workers.map([_ONLY_PREPARE])]
    assert not results  # preparation localizes no query
    return perf_counter() - began


def _localize_in_threads(
    run: Run, queries: Sequence[BenchmarkQuery], jobs: int, store: StoreResult
) -> Generator[float | None, None, None]:
    """Localize queries in threads, and yield the peak memory whenever a result is stored."""

    def localize(query: BenchmarkQuery) -> float | None:
        result, memory = run.localize(query)
        store(result)
        return memory

    yield from map_unordered(localize, queries, jobs)
