"""Statistics of two runs over the same queries."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from benchmark.score import Z_95


class PairedChange(NamedTuple):
    """How recall changed between two runs over the same n queries.

    Attributes:
        queries: n.
        lost: right before, wrong now.
        won: wrong before, right now.
        p_drop: probability of at least so many losses among the changed queries were a loss and a
            win equally likely: McNemar's exact test, one-sided.
        change: in percentage points; negative is a drop.
        low: lower end of its 95 % interval.
        high: upper end.
    """

    queries: int
    lost: int
    won: int
    p_drop: float
    change: float
    low: float
    high: float


def compare(before: Sequence[bool], after: Sequence[bool]) -> PairedChange:
    """Compare two runs, query by query.

    The interval is Bonett and Price's adjusted Wald interval for paired proportions (J. Educ.
    Behav. Stat. 37, 2012), which keeps its coverage also for small n.

    Args:
        before: whether each query was right.
        after: the same queries in the same order.

    Raises:
        ValueError: the runs have different lengths or none.
    """
    if len(before) != len(after) or not before:
        raise ValueError(f"runs of {len(before)} and {len(after)} queries cannot be paired")
    n = len(before)
    lost = sum(b and not a for b, a in zip(before, after, strict=True))
    won = sum(a and not b for b, a in zip(before, after, strict=True))
    p, q = (lost + 1) / (n + 2), (won + 1) / (n + 2)
    half = Z_95 * math.sqrt((p + q - (p - q) ** 2) / (n + 2))
    return PairedChange(
        queries=n,
        lost=lost,
        won=won,
        p_drop=_upper_tail(lost, lost + won),
        change=100 * (won - lost) / n,
        low=100 * max(q - p - half, -1.0),
        high=100 * min(q - p + half, 1.0),
    )


def mcnemar(lost: int, won: int) -> float:
    """Two-sided p value of McNemar's exact test: do the two runs differ at all?"""
    return min(1.0, 2 * _upper_tail(max(lost, won), lost + won))


def _upper_tail(k: int, n: int) -> float:
    """P(X >= k) of a fair coin thrown n times."""
    favourable = sum(math.comb(n, i) for i in range(k, n + 1))
    return favourable / float(2**n)
