"""Figures of a set of queries: recall, errors, uncertainty, seconds."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import Final

from benchmark.results.query_result import QueryResult
from benchmark.scoring.score import THRESHOLDS, false_fixes, median_errors, recall
from benchmark.scoring.uncertainty import consistency
from objconnect.scene.localizer import Status
from objconnect.scene.storage.records import Record

# Width of an altitude band, metres.
_BAND_M = 30


class Recall(Record):
    """A percentage of queries with the ends of its Wilson 95 % interval in percent."""

    value: float
    low: float
    high: float


class Seconds(Record):
    """Wall-clock seconds of a method.

    Attributes:
        prepare: seconds of the preparation, once per run.
        per_query: mean over all queries by stage. A stage that a query did not reach counts as
            zero, and "total" is the whole call.
    """

    prepare: float
    per_query: dict[str, float]


class Uncertainty(Record):
    """Figures that compare errors with predicted covariances.

    See ``benchmark.scoring.uncertainty.Consistency``.
    """

    queries: int
    nees_mean: float
    nees_median: float
    within_95: Recall


class Summary(Record):
    """Figures of a set of queries.

    Attributes:
        queries: number of queries; all of them are in every denominator.
        recall: recall by the key of a threshold, such as "0.25m_2deg".
        false_fixes: share of the queries with a pose of status ``ok`` that is wrong by more than
            5 m or 10 degrees; None only as read from a file of an earlier version.
        median_t_m: median position error of the queries with a pose, metres; None without any.
        median_r_deg: median rotation error of the queries with a pose, degrees; None without any.
        failed: number of queries without a pose.
        uncertainty: figures of the localized queries with a covariance; None without any.
        fallback: number of queries whose pose is only the prior's or that of a map photograph; they
            count as wrong.
        seconds: times; ``prepare`` is that of the whole run, even for a part of its queries.
        peak_memory_mb: peak memory of the process during the whole run (1e6 bytes); None where the
            system does not measure it.
    """

    queries: int
    recall: dict[str, Recall]
    false_fixes: Recall | None = None
    median_t_m: float | None
    median_r_deg: float | None
    failed: int
    fallback: int
    uncertainty: Uncertainty | None
    seconds: Seconds
    peak_memory_mb: float | None


def summarize(
    queries: Sequence[QueryResult], prepare: float, peak_memory_mb: float | None
) -> Summary:
    """Return the figures of queries.

    Args:
        queries: queries of a run; at least one.
        prepare: seconds that the run took before its first query.
        peak_memory_mb: peak memory of the run (1e6 bytes); None if unknown.
    """
    median_t, median_r = median_errors(queries)
    stages = dict.fromkeys(stage for query in queries for stage in query.seconds)
    return Summary(
        queries=len(queries),
        recall={
            threshold.key: Recall(**recall(queries, threshold)._asdict())
            for threshold in THRESHOLDS
        },
        false_fixes=Recall(**false_fixes(queries)._asdict()),
        median_t_m=median_t,
        median_r_deg=median_r,
        failed=sum(query.status is Status.FAILED for query in queries),
        fallback=sum(query.status is Status.FALLBACK for query in queries),
        uncertainty=_uncertainty(queries),
        seconds=Seconds(
            prepare=prepare,
            per_query={
                stage: math.fsum(query.seconds.get(stage, 0.0) for query in queries) / len(queries)
                for stage in stages
            },
        ),
        peak_memory_mb=peak_memory_mb,
    )


def summarize_parts(
    queries: Sequence[QueryResult], prepare: float, peak_memory_mb: float | None
) -> dict[str, dict[str, Summary]]:
    """Return the figures of the queries by condition, group and altitude.

    Returns:
        For each of "condition", "group" and "altitude" the summaries by name.
    """
    parts: dict[str, dict[str, Summary]] = {}
    for part, name_of in PARTS.items():
        names = sorted({name_of(query) for query in queries}, key=_natural)
        parts[part] = {
            name: summarize(
                [query for query in queries if name_of(query) == name], prepare, peak_memory_mb
            )
            for name in names
        }
    return parts


def _band(query: QueryResult) -> str:
    """Return the altitude band of a query, such as "60-90 m"."""
    low = _BAND_M * math.floor(query.altitude_m / _BAND_M)
    return f"{low}-{low + _BAND_M} m"


def _natural(name: str) -> tuple[int, str]:
    """Return a key that sorts altitude bands by height and other names alphabetically."""
    match = re.match(r"(-?[0-9]+)-", name) if name.endswith(" m") else None
    return int(match.group(1)) if match else 0, name


PARTS: Final[dict[str, Callable[[QueryResult], str]]] = {
    "condition": lambda query: query.condition,
    "group": lambda query: query.group,
    "altitude": _band,
}


def _uncertainty(queries: Sequence[QueryResult]) -> Uncertainty | None:
    figures = consistency(queries)
    if figures is None:
        return None
    return Uncertainty(
        queries=figures.queries,
        nees_mean=figures.mean,
        nees_median=figures.median,
        within_95=Recall(**figures.within_95._asdict()),
    )
