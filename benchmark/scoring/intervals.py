"""Intervals of shares and means, where queries of one flight path (*course*) fail together.

Photographs of one course share light, weather, height, tilt and the ground below. An interval that
treats them as independent is too narrow. If the recalls of 14 courses of 200 queries each have a
mean of 90 % and a standard deviation of 5 points, it covers the truth in about half of all
experiments instead of 95 %; ``tests/benchmark/scoring/test_intervals.py`` simulates this.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

Z_95: Final = 1.959963984540054
"""Quantile of the normal distribution for a two-sided 95 % interval."""


class Interval(NamedTuple):
    """A share of queries with its 95 % interval, all in percent.

    The ends are None where all queries are of one course: the spread between courses
    is then unknown.
    """

    value: float
    low: float | None
    high: float | None

    def text(self) -> str:
        """Return the share and its interval for a table, such as ``96.4 [95.2, 97.2]``."""
        ends = "–" if self.low is None or self.high is None else f"{self.low:.1f}, {self.high:.1f}"
        return f"{self.value:.1f} [{ends}]"


def share(right: Sequence[bool] | NDArray[np.bool_], clusters: Sequence[str]) -> Interval:
    """Return the percentage of queries that are right, with its 95 % interval by clusters.

    Args:
        right: whether each query is right; at least one.
        clusters: cluster of each query, such as its course.
    """
    cluster = number_clusters(clusters)
    counts = np.asarray(np.bincount(cluster, np.asarray(right, np.float64)), np.float64)
    return share_of_counts(counts, np.bincount(cluster))


def share_of_counts(right: NDArray[np.float64], size: NDArray[np.int64]) -> Interval:
    """Return the percentage of queries that are right, with its 95 % interval by clusters.

    It is Wilson's interval with the effective number of queries n / d * (z / t)^2. The design
    effect d is the variance between clusters over that of independent queries (Rao and Scott,
    Biometrics 48, 1992), and at least 1. The quantile t of Student's distribution with k - 1
    degrees of freedom accounts for the small number of clusters (Korn and Graubard, Survey
    Methodology 24, 1998). Where all queries are right or all are wrong, d is unknown and taken as
    1, as Korn and Graubard do.

    Args:
        right: (k,) number of right queries of each cluster.
        size: (k,) number of queries of each cluster, at least 1.
    """
    count, clusters = int(size.sum()), len(size)
    value = float(right.sum()) / count
    if clusters < 2:
        return Interval(100 * value, None, None)
    cluster_variance = clusters / (clusters - 1) * float(np.square(right - value * size).sum())
    independent_variance = count * value * (1 - value)
    design = max(cluster_variance / independent_variance, 1.0) if independent_variance else 1.0
    effective = count / design * (Z_95 / student_95(clusters - 1)) ** 2
    low, high = wilson(value * effective, effective)
    return Interval(100 * value, 100 * low, 100 * high)


def mean_interval(
    values: Sequence[float] | NDArray[np.float64], clusters: Sequence[str]
) -> tuple[float, float] | None:
    """Return the 95 % interval of the mean of a value of each query, by clusters.

    The clusters are a sample of all clusters: cluster-robust variance with Student's t (Cameron and
    Miller, "A Practitioner's Guide to Cluster-Robust Inference", J. Human Resources 50, 2015).

    Args:
        values: value of each query; at least one.
        clusters: cluster of each query, such as its course.

    Returns:
        The lower and the upper end, in the unit of the values; None with one cluster.
    """
    cluster = number_clusters(clusters)
    total = np.asarray(np.bincount(cluster, np.asarray(values, np.float64)), np.float64)
    size = np.bincount(cluster)
    k = len(size)
    if k < 2:
        return None
    mean = float(total.sum() / size.sum())
    variance = k / (k - 1) * np.square(total - mean * size).sum() / size.sum() ** 2
    half = student_95(k - 1) * math.sqrt(variance)
    return mean - half, mean + half


def number_clusters(names: Sequence[str]) -> NDArray[np.int64]:
    """Return (N,) numbers of clusters from 0 on, in the order in which their names appear."""
    numbers: dict[str, int] = {}
    return np.array([numbers.setdefault(name, len(numbers)) for name in names], np.int64)


def student_95(degrees_of_freedom: int) -> float:
    """Return the quantile of Student's t for a two-sided 95 % interval, by degrees of freedom."""
    return float(stdtrit(degrees_of_freedom, 0.975))


def wilson(successes: float, trials: float) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a proportion as fractions in [0, 1].

    Unlike the normal approximation, it does not shrink to a point at 0 and 100 %.

    Args:
        successes: number of successes.
        trials: number of independent trials, or effective number, greater than 0.
    """
    p, z2 = successes / trials, Z_95 * Z_95
    centre = (p + z2 / (2 * trials)) / (1 + z2 / trials)
    half = Z_95 / (1 + z2 / trials) * math.sqrt(p * (1 - p) / trials + z2 / (4 * trials**2))
    # Without a success the lower end is exactly 0, and with only successes the upper end is exactly
    # 1; rounding errors would prevent this.
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == trials else centre + half
    return low, high
