from __future__ import annotations

import numpy as np
import pytest

from benchmark.report.page import compare_paired
from benchmark.scoring.clustered import MIN_CLUSTERS, difference_interval, permutation_p
from benchmark.scoring.paired import compare, mcnemar


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


def test_resamples_are_the_same_at_every_run() -> None:
    queries = [k % 3 == 0 for k in range(60)]
    flights = [str(k % 6) for k in range(60)]
    drawn = {difference_interval(queries, queries[::-1], flights) for _ in range(3)}
    assert len(drawn) == 1


def test_the_permutation_test_exchanges_whole_flights() -> None:
    """Of eight flights that all lose five queries, two of 2^8 signs are as extreme."""
    flights = [f"flight-{k // 10}" for k in range(80)]
    after = [k % 10 >= 5 for k in range(80)]
    assert permutation_p([True] * 80, after, flights) == 2 / 2**8
    assert permutation_p(after, after, flights) == 1
    assert permutation_p([True] * 40, after[:40], flights[:40]) is None


def test_p_of_many_flights_is_that_of_random_signs() -> None:
    """Flights of one query each: the test is McNemar's but for the draws."""
    before, after = [True] * 13 + [False] * 4, [False] * 13 + [True] * 4
    found = permutation_p(before, after, [str(k) for k in range(17)])
    assert found == pytest.approx(mcnemar(13, 4), abs=0.01)


def test_flights_that_differ_by_themselves_raise_no_false_alarm() -> None:
    """Twenty flights in which either method is better by chance: 5 % of p are below 0.05."""
    rng = np.random.default_rng(0)
    flights = [f"flight-{k // 28}" for k in range(560)]
    alarms, independent = 0, 0
    for _ in range(200):
        shares = 0.6 + rng.uniform(-0.3, 0.3, (2, 20)).repeat(28, axis=1)
        before, after = (rng.random((2, 560)) < shares).tolist()
        change = compare_paired(before, after, flights)
        alarms += change["p"] < 0.05
        independent += mcnemar(change["lost"], change["won"]) < 0.05
    assert 2 <= alarms <= 20
    assert independent > 40  # one in five and more


def test_interval_of_flights_that_change_alike_is_not_a_point() -> None:
    flights = [f"flight-{k // 20}" for k in range(200)]
    before, after = [True] * 200, [k % 20 > 0 for k in range(200)]
    assert difference_interval(before, after, flights) == (-5, -5)
    change, apart = compare_paired(before, after, flights), compare(before, after)
    assert (change["low"], change["high"]) == pytest.approx((apart.low, apart.high), abs=0.01)


def test_mcnemar_is_two_sided() -> None:
    assert mcnemar(0, 0) == 1
    assert mcnemar(3, 3) == 1
    # 2 * (1 + 8) / 2^8
    assert mcnemar(1, 7) == mcnemar(7, 1) == pytest.approx(0.0703125)
