"""Confidence intervals for queries that are not independent within a flight.

Photographs of one flight share light, weather and the map below them, so that they tend to fail
together. An interval that treats them as independent is too narrow. The cluster bootstrap resamples
whole flights instead (Field and Welsh, J. R. Stat. Soc. B 69, 2007).
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
    if not len(before) == len(after) == len(clusters):
        raise ValueError(f"{len(before)}, {len(after)} and {len(clusters)} queries do not pair")
    names, row = np.unique(np.array(clusters, dtype=object).astype(str), return_inverse=True)
    k = len(names)
    if k < MIN_CLUSTERS:
        return None
    change = np.array(after, np.float64) - np.array(before, np.float64)
    total, size = np.bincount(row, change, k), np.bincount(row, minlength=k)
    drawn = _draws(k, seed)
    low, high = np.percentile(100 * (drawn @ total) / (drawn @ size), [2.5, 97.5])
    return float(low), float(high)


@lru_cache(maxsize=8)
def _draws(k: int, seed: int) -> NDArray[np.int64]:
    """Return how often each of k flights is drawn in each resample.

    A page compares thousands of pairs that have the same number of flights.
    """
    return np.random.default_rng(seed).multinomial(k, np.full(k, 1 / k), _DRAWS)
