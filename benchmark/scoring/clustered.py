"""Intervals and p values for queries that are not independent within a flight.

Photographs of one flight share light, weather and the map below them, so that they tend to fail
together. An interval that treats them as independent is too narrow, a p value too small. The
cluster bootstrap resamples whole flights instead (Field and Welsh, J. R. Stat. Soc. B 69, 2007),
and the permutation test exchanges the two runs flight by flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

_DRAWS: Final = 4000
# With k flights, one resample in k^(k-1) repeats a single flight. With fewer than five flights this
# is too frequent for the ends of a 95 % interval to be meaningful.
MIN_CLUSTERS: Final = 5
# Largest number of flights for which all sign patterns are tried; else so many random ones.
_EXACT: Final = 12
_FLIPS: Final = 9999


def difference_interval(
    before: Sequence[bool], after: Sequence[bool], clusters: Sequence[str], seed: int = 0
) -> tuple[float, float] | None:
    """Return the 95 % percentile interval of the change of recall, in percentage points.

    Args:
        before: whether each query was correct in the first run.
        after: whether it was correct in the second run, in the same order.
        clusters: flight of each query.
        seed: random seed of the resamples.

    Returns:
        The lower and the upper end; None with fewer than ``MIN_CLUSTERS`` flights.

    Raises:
        ValueError: the lengths differ.
    """
    total, size = _by_cluster(before, after, clusters)
    if len(size) < MIN_CLUSTERS:
        return None
    drawn = _draws(len(size), seed)
    low, high = np.percentile(100 * (drawn @ total) / (drawn @ size), [2.5, 97.5])
    return float(low), float(high)


def permutation_p(
    before: Sequence[bool], after: Sequence[bool], clusters: Sequence[str], seed: int = 0
) -> float | None:
    """Return the two-sided p value of whether two runs differ, for flights as a whole.

    Under the null hypothesis, the change of each flight is equally likely with the other sign. The
    p value is the share of all sign patterns whose total change is at least as large as the
    observed one. If more than ``_EXACT`` flights changed, ``_FLIPS`` random patterns and the
    observed one stand for all.

    Args:
        before: whether each query was correct in the first run.
        after: whether it was correct in the second run, in the same order.
        clusters: flight of each query.
        seed: random seed of the signs.

    Returns:
        The p value; None with fewer than ``MIN_CLUSTERS`` flights.

    Raises:
        ValueError: the lengths differ.
    """
    total, _ = _by_cluster(before, after, clusters)
    if len(total) < MIN_CLUSTERS:
        return None
    changed = total[total != 0]
    as_large = np.abs(_signs(len(changed), seed) @ changed) >= abs(changed.sum())
    if len(changed) <= _EXACT:
        return float(as_large.mean())
    return float((1 + as_large.sum()) / (1 + len(as_large)))


def _by_cluster(
    before: Sequence[bool], after: Sequence[bool], clusters: Sequence[str]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the change of the number of correct queries of each flight, and its queries."""
    if not len(before) == len(after) == len(clusters):
        raise ValueError(f"{len(before)}, {len(after)} and {len(clusters)} queries do not pair")
    names, row = np.unique(np.array(clusters, dtype=object).astype(str), return_inverse=True)
    change = np.array(after, np.float64) - np.array(before, np.float64)
    k = len(names)
    total = np.asarray(np.bincount(row, change, k), np.float64)
    return total, np.bincount(row, minlength=k)


@lru_cache(maxsize=8)
def _draws(k: int, seed: int) -> NDArray[np.int64]:
    """Return how often each of k flights is drawn in each resample.

    A page compares thousands of pairs that have the same number of flights.
    """
    return np.random.default_rng(seed).multinomial(k, np.full(k, 1 / k), _DRAWS)


@lru_cache(maxsize=64)
def _signs(k: int, seed: int) -> NDArray[np.int8]:
    """Return sign patterns of k flights, one per row: all of them, or random ones for large k."""
    if k <= _EXACT:
        bits = np.arange(2**k)[:, None] >> np.arange(k) & 1
    else:
        bits = np.random.default_rng(seed).integers(0, 2, (_FLIPS, k))
    return np.asarray(2 * bits - 1, np.int8)
