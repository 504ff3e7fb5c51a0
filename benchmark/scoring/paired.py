"""Statistics of two runs on the same queries."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

from benchmark.scoring.intervals import Z_95


class PairedChange(NamedTuple):
    """The change of recall between two runs on the same n queries.

    Attributes:
        queries: n.
        lost: number of queries that were correct before and are wrong now.
        won: number of queries that were wrong before and are correct now.
        p_drop: one-sided p value of McNemar's exact test: the probability of at least this many
            losses among the changed queries if losses and wins were equally likely.
        change: change of recall in percentage points; a drop is negative.
        low: lower end of the 95 % interval of the change.
        high: upper end of the 95 % interval of the change.
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

    The interval is the adjusted Wald interval of Bonett and Price for paired proportions (J. Educ.
    Behav. Stat. 37, 2012), which keeps its coverage for small n.

    Args:
        before: whether each query was correct in the first run.
        after: whether it was correct in the second run, in the same order.

    Raises:
        ValueError: the runs have different lengths or no query.
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
    """Return the two-sided p value of McNemar's exact test of whether two runs differ."""
    return min(1.0, 2 * _upper_tail(max(lost, won), lost + won))


def _upper_tail(k: int, n: int) -> float:
    """Return P(X >= k) for the number X of heads in n throws of a fair coin."""
    term = math.comb(n, k)
    favourable = 0
    for i in range(k, n + 1):
        favourable += term
        term = term * (n - i) // (i + 1)
    # 2.0**n overflows from n = 1024 on.
    return float(Fraction(favourable, 2**n))
