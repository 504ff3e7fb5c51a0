from __future__ import annotations

import numpy as np
import pytest

from benchmark.clustered import MIN_CLUSTERS, difference_interval
from benchmark.paired import mcnemar


def test_queries_that_fail_together_widen_the_interval() -> None:
    """Whole flights lost: as independent queries the interval would be sqrt(20) times narrower."""
    flights = [f"flight-{k // 20}" for k in range(200)]
    before = [True] * 200
    after = [k // 20 not in (3, 7) for k in range(200)]
    together = difference_interval(before, after, flights)
    apart = difference_interval(before, after, [str(k) for k in range(200)])
    assert together is not None
    assert apart is not None
    # Ten flights with a share of 0.2 lost: binomial standard deviation 12.6 points.
    assert together == (pytest.approx(-50, abs=6), pytest.approx(0, abs=6))
    assert apart == (pytest.approx(-25.5, abs=2), pytest.approx(-14.5, abs=2))


def test_flights_of_one_query_each_agree_with_the_normal_interval() -> None:
    rng = np.random.default_rng(0)
    before, after = (list(rng.random(400) < share) for share in (0.5, 0.6))
    low, high = difference_interval(before, after, [str(k) for k in range(400)]) or (0, 0)
    change = np.array(after, float) - np.array(before, float)
    half = 196 * change.std() / np.sqrt(400)
    assert low == pytest.approx(100 * change.mean() - half, abs=1)
    assert high == pytest.approx(100 * change.mean() + half, abs=1)


def test_too_few_flights_have_no_interval() -> None:
    flights = [str(k % (MIN_CLUSTERS - 1)) for k in range(100)]
    assert difference_interval([True] * 100, [False] * 100, flights) is None


def test_the_same_at_every_run() -> None:
    queries = [k % 3 == 0 for k in range(60)]
    flights = [str(k % 6) for k in range(60)]
    drawn = {difference_interval(queries, queries[::-1], flights) for _ in range(3)}
    assert len(drawn) == 1


def test_mcnemar_is_two_sided() -> None:
    assert mcnemar(0, 0) == 1
    assert mcnemar(3, 3) == 1
    # 2 * (1 + 8) / 2^8
    assert mcnemar(1, 7) == mcnemar(7, 1) == pytest.approx(0.0703125)
