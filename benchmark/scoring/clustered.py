"""The comparison of two runs, where queries along one flight path (*course*) fail together.

The interval treats the courses as a sample of all courses, see ``intervals.mean_interval``. The
permutation test exchanges the two runs course by course.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.scoring.intervals import mean_interval, number_clusters

# Up to this many courses, all sign patterns are tried; with more courses, random ones.
_EXACT_COURSES: Final = 14
_RANDOM_PATTERNS: Final = 9999


def difference_interval(
    before: Sequence[bool], after: Sequence[bool], clusters: Sequence[str]
) -> tuple[float, float] | None:
    """Return the 95 % interval of the change of recall, in percentage points.

    Args:
        before: whether each query was correct in the first run.
        after: whether it was correct in the second run, in the same order.
        clusters: course of each query.

    Returns:
        The lower and the upper end; None with one course.

    Raises:
        ValueError: the lengths differ.
    """
    if (ends := mean_interval(_gains(before, after, clusters), clusters)) is None:
        return None
    return 100 * max(ends[0], -1.0), 100 * min(ends[1], 1.0)


def permutation_p(
    before: Sequence[bool], after: Sequence[bool], clusters: Sequence[str], seed: int = 0
) -> float | None:
    """Return the two-sided p value of whether two runs differ, with courses as units.

    Under the null hypothesis, the change of each course is equally likely with the other sign. The
    p value is the share of all sign patterns whose total change is at least as large as the
    observed one. If more than ``_EXACT_COURSES`` courses changed, ``_RANDOM_PATTERNS`` random
    patterns and the observed one stand for all. With k courses, p is never below 2 / 2^k.

    Args:
        before: whether each query was correct in the first run.
        after: whether it was correct in the second run, in the same order.
        clusters: course of each query.
        seed: random seed of the signs.

    Returns:
        The p value; None with one course.

    Raises:
        ValueError: the lengths differ.
    """
    gains, cluster = _gains(before, after, clusters), number_clusters(clusters)
    gained = np.asarray(np.bincount(cluster, gains), np.float64)
    if len(gained) < 2:
        return None
    changed = gained[gained != 0]
    as_large = np.abs(_signs(len(changed), seed) @ changed) >= abs(changed.sum())
    if len(changed) <= _EXACT_COURSES:
        return float(as_large.mean())
    return float((1 + as_large.sum()) / (1 + len(as_large)))


def _gains(
    before: Sequence[bool], after: Sequence[bool], clusters: Sequence[str]
) -> NDArray[np.float64]:
    """Return (N,) 1 for a query that only the second run finds, -1 for one that only the first
    does, and 0 otherwise."""
    if not len(before) == len(after) == len(clusters):
        raise ValueError(f"{len(before)}, {len(after)} and {len(clusters)} queries do not pair")
    return np.array(after, np.float64) - np.array(before, np.float64)


@lru_cache(maxsize=64)
def _signs(k: int, seed: int) -> NDArray[np.int8]:
    """Return sign patterns of k courses, one per row: all of them, or random ones for large k."""
    if k <= _EXACT_COURSES:
        bits = np.arange(2**k)[:, None] >> np.arange(k) & 1
    else:
        bits = np.random.default_rng(seed).integers(0, 2, (_RANDOM_PATTERNS, k))
    return np.asarray(2 * bits - 1, np.int8)
