"""Intervals that respect that queries of one flight go together.

Photographs of one flight share light, weather and the map below them: they fail together, and an
interval that takes them for independent is too narrow. Resampling whole flights (the bootstrap
clustered by flight; Field and Welsh, J. R. Stat. Soc. B 69, 2007) keeps them together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

_DRAWS: Final = 4000
# With k flights one draw in k^(k-1) holds a single one alone: below five that happens too often for
# the ends of a 95 % interval to mean anything.
MIN_CLUSTERS: Final = 5


def difference_interval(
    before: Sequence[bool], after: Sequence[bool], clusters: Sequence[str], seed: int = 0
) -> tuple[float, float] | None:
    """The 95 % percentile interval of the change of recall, in percentage points.

    Args:
        before: whether each query was right.
        after: the same queries in the same order.
        clusters: the flight of each query.
        seed: of the draws.

    Returns:
        Lower and upper end; None with fewer than ``MIN_CLUSTERS`` flights.

    Raises:
        ValueError: lengths differ.
    """
    if not len(before) == len(after) == len(clusters):
        raise ValueError(f"{len(before)}, {len(after)} and {len(clusters)} queries do not pair")
    names, row = np.unique(np.array(clusters, dtype=object).astype(str), return_inverse=True)
    k = len(names)
    if k < MIN_CLUSTERS:
        return None
    change = np.array(after, np.float64) - np.array(before, np.float64)
    total, size = np.bincount(row, change, k), np.bincount(row, minlength=k)
    drawn = np.random.default_rng(seed).multinomial(k, np.full(k, 1 / k), _DRAWS)
    low, high = np.percentile(100 * (drawn @ total) / (drawn @ size), [2.5, 97.5])
    return float(low), float(high)
