"""Runs one localizer over one data set."""

from __future__ import annotations

import logging
from pathlib import Path
from time import perf_counter

import numpy as np
import torch

from benchmark.album import ALBUM, keep_album
from benchmark.datasets import BenchmarkQuery, Dataset
from benchmark.memory import peak_megabytes, reset_peak
from benchmark.pictures import median_query, query_overlay
from benchmark.results import (
    TOTAL,
    DatasetId,
    Environment,
    Method,
    PoseNumbers,
    QueryResult,
    Results,
    summarize,
    summarize_by_condition,
)
from scene.errors import InputError
from scene.localizer import Estimate, Localizer, Query, Status
from scene.pose import Pose
from scene.progress import progress_bar
from scene.sparse_map import SparseMap

log = logging.getLogger(__name__)


def evaluate(
    dataset: Dataset,
    localizer: Localizer,
    out: Path,
    use_prior: bool = True,
    cache: Path | None = None,
) -> Results:
    """Localize every query, score it, and write ``OUT/<dataset>/<method>.json`` at the end.

    Beside it goes ``<method>-query.png``, the map drawn into the query of median error, and
    ``album.h5``, what the page shows of each query. Nothing is written before the last query is
    done. A method that raises an exception on a query has failed
    on that query, and the run goes on.

    Args:
        dataset: what to run on.
        localizer: what to run.
        out: folder of the results.
        use_prior: hand each query's prior to the method.
        cache: folder for the method's per-map state, or None to keep none.

    Raises:
        InputError: the map or a photograph is missing or broken, or ``out`` cannot be written.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"cannot write results to {out}: it is not a folder")
    given = sum(query.prior is not None for query in dataset.queries) if use_prior else 0
    if use_prior and 0 < given < len(dataset.queries):
        missing = len(dataset.queries) - given
        log.warning("%s: %d queries have no prior", dataset.name, missing)

    reset_peak()
    sparse_map = dataset.load_map()
    start = perf_counter()
    localizer.prepare(sparse_map, dataset.images, cache)
    prepare = perf_counter() - start

    queries = []
    with progress_bar(f"{dataset.name} {localizer.name}", len(dataset.queries)) as advance:
        for query in dataset.queries:
            loaded = query.load(use_prior)
            start = perf_counter()
            estimate = attempt(localizer, loaded)
            queries.append(_scored(query, estimate, perf_counter() - start))
            advance(len(queries))

    run = prepare, peak_megabytes()
    results = Results(
        method=method_of(localizer),
        dataset=dataset_id(dataset),
        start="prior" if given else "none",
        environment=Environment.current(),
        summary=summarize(queries, *run),
        by_condition=summarize_by_condition(queries, *run),
        queries=tuple(queries),
    )
    target = results_path(out, dataset, localizer)
    results.write(target)
    keep_album(target.with_name(ALBUM), dataset, sparse_map)
    _draw_median(dataset, sparse_map, results, target.with_name(f"{localizer.name}-query.png"))
    return results


def results_path(out: Path, dataset: Dataset, localizer: Localizer) -> Path:
    """Where the results of a method on a data set lie."""
    return out / dataset.name / f"{localizer.name}.json"


def method_of(localizer: Localizer) -> Method:
    """What is written of a method into its results."""
    return Method(
        name=localizer.name,
        config=localizer.config.model_dump(mode="json"),
        weights_sha256=localizer.weights_sha256,
    )


def dataset_id(dataset: Dataset) -> DatasetId:
    """What is written of a data set into results."""
    return DatasetId(
        name=dataset.name,
        track=dataset.track,
        sha256=dataset.sha256,
        map_conditions=dataset.map_conditions,
    )


def attempt(localizer: Localizer, query: Query) -> Estimate:
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
    if not bool(estimate.cam_from_world.matrix().isfinite().all()):
        return Estimate(Status.FAILED, reason="the pose is not finite")
    return estimate


def _scored(query: BenchmarkQuery, estimate: Estimate, seconds: float) -> QueryResult:
    pose = estimate.cam_from_world if estimate.status is not Status.FAILED else None
    numbers = t_err = r_err = None
    if pose is not None:
        pose = pose.to(dtype=torch.float64, device=torch.device("cpu"))
        numbers = (*pose.quaternion().tolist(), *pose.translation.tolist())
        # What is scored is what is written.
        metres, degrees = _pose(numbers).error_to(query.reference)
        t_err, r_err = float(metres), float(degrees)
    sigma = estimate.sigma_position()
    return QueryResult(
        name=query.name,
        condition=query.condition,
        status=estimate.status,
        reason=estimate.reason,
        t_err_m=t_err,
        r_err_deg=r_err,
        cam_from_world=numbers,
        sigma_t_m=sigma if sigma is not None and np.isfinite(sigma) else None,
        iterations=estimate.iterations,
        inliers=estimate.inliers,
        seconds=estimate.seconds | {TOTAL: seconds},
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
