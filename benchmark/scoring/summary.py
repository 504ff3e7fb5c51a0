"""Metrics of a set of queries: recall, errors, uncertainty, seconds."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Sequence
from typing import Final

from benchmark.results.query_result import QueryResult
from benchmark.scoring.intervals import Interval
from benchmark.scoring.score import (
    FALSE_FIX,
    THRESHOLDS,
    WRONG_TEXT,
    false_fixes,
    median_errors,
    recall,
    worse_than_prior,
    wrong_answers,
)
from benchmark.scoring.uncertainty import consistency
from objconnect.scene.localizer import Status
from objconnect.scene.storage.records import Record

# Width of an altitude band, metres.
_BAND_M = 30


class Percentage(Record):
    """A percentage of queries with the ends of its 95 % interval, in percent.

    The interval treats flight paths (courses) as independent, not queries. The ends are None where
    all queries are of one course.
    """

    value: float
    low: float | None
    high: float | None

    def text(self) -> str:
        """Return the percentage and its interval for a table."""
        return Interval(self.value, self.low, self.high).text()


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

    See ``benchmark.scoring.uncertainty.Consistency``. The ends of the interval of the mean are None
    with one course, and as read from a file of an earlier version.
    """

    queries: int
    nees_mean: float
    nees_low: float | None = None
    nees_high: float | None = None
    nees_median: float
    within_95: Percentage


class Summary(Record):
    """Figures of a set of queries.

    Attributes:
        queries: number of queries; all of them are in every denominator.
        courses: number of courses that they were flown on; None only as read from a file of an
            earlier version.
        recall: recall by the key of a threshold, such as "0.25m_2deg"; None where the reference
            poses are too inexact for the threshold.
        false_fixes: share of the queries with a pose of status ``ok`` that is wrong by more than
            5 m or 10 degrees; None where the reference poses are too inexact for it, or as read
            from a file of an earlier version.
        wrong_1m: share of the queries with a pose of status ``ok`` whose position is wrong by more
            than 1 m; None for the same reasons.
        worse_than_prior: share of the queries whose prior has a position, with a pose of status
            ``ok`` that is farther off than that position; None for the same reasons, and without
            such a query.
        median_t_m: median position error of the queries with a pose, metres; None without any.
        median_r_deg: median rotation error of the queries with a pose, degrees; None without any.
        failed: number of queries without a pose.
        uncertainty: figures of the localized queries with a covariance; None without any.
        fallback: number of queries whose pose is only the prior's, a candidate or that of a map
            photograph; they count as not found.
        seconds: times; ``prepare`` is that of the whole run, even for a part of its queries.
        peak_memory_mb: peak memory of the process during the whole run (1e6 bytes); None where the
            system does not measure it.
    """

    queries: int
    courses: int | None = None
    recall: dict[str, Percentage | None]
    false_fixes: Percentage | None = None
    wrong_1m: Percentage | None = None
    worse_than_prior: Percentage | None = None
    median_t_m: float | None
    median_r_deg: float | None
    failed: int
    fallback: int
    uncertainty: Uncertainty | None
    seconds: Seconds
    peak_memory_mb: float | None

    def integrity(self) -> tuple[Percentage | None, Percentage | None, Percentage | None]:
        """Return the shares of false fixes, wrong answers and answers worse than the prior."""
        return self.false_fixes, self.wrong_1m, self.worse_than_prior


def summarize(
    queries: Sequence[QueryResult],
    prepare: float = 0.0,
    peak_memory_mb: float | None = None,
    unjudged: Collection[str] = (),
) -> Summary:
    """Return the figures of queries.

    Args:
        queries: queries of a run; at least one.
        prepare: seconds that the run took before its first query.
        peak_memory_mb: peak memory of the run (1e6 bytes); None if unknown.
        unjudged: thresholds that the reference poses are too inexact for, see
            ``Dataset.unjudged``; their figures are None. If "1 m" is among them, the shares of
            wrong answers and of answers worse than their prior are None.
    """
    median_t, median_r = median_errors(queries)
    stages = dict.fromkeys(stage for query in queries for stage in query.seconds)
    return Summary(
        queries=len(queries),
        courses=len({query.course_name for query in queries}),
        recall={
            threshold.key: _judge(recall(queries, threshold), str(threshold), unjudged)
            for threshold in THRESHOLDS
        },
        false_fixes=_judge(false_fixes(queries), str(FALSE_FIX), unjudged),
        wrong_1m=_judge(wrong_answers(queries), WRONG_TEXT, unjudged),
        worse_than_prior=_judge(worse_than_prior(queries), WRONG_TEXT, unjudged),
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
    queries: Sequence[QueryResult],
    prepare: float = 0.0,
    peak_memory_mb: float | None = None,
    unjudged: Collection[str] = (),
) -> dict[str, dict[str, Summary]]:
    """Return the figures of the queries by condition, group and altitude.

    The arguments are those of ``summarize``.

    Returns:
        For each of "condition", "group" and "altitude" the summaries by name.
    """
    parts: dict[str, dict[str, Summary]] = {}
    for part, name_of in PARTS.items():
        names = sorted({name_of(query) for query in queries}, key=_sort_key)
        parts[part] = {
            name: summarize(
                [query for query in queries if name_of(query) == name],
                prepare,
                peak_memory_mb,
                unjudged,
            )
            for name in names
        }
    return parts


def _judge(figure: Interval | None, bound: str, unjudged: Collection[str]) -> Percentage | None:
    """Return a figure; None if it is unknown or the reference poses are too inexact for it."""
    return None if figure is None or bound in unjudged else Percentage(**figure._asdict())


def _band(query: QueryResult) -> str:
    """Return the altitude band of a query, such as "60-90 m"."""
    low = _BAND_M * math.floor(query.altitude_m / _BAND_M)
    return f"{low}-{low + _BAND_M} m"


def _sort_key(name: str) -> tuple[int, str]:
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
    low, high = figures.ends or (None, None)
    return Uncertainty(
        queries=figures.queries,
        nees_mean=figures.mean,
        nees_low=low,
        nees_high=high,
        nees_median=figures.median,
        within_95=Percentage(**figures.within_95._asdict()),
    )
