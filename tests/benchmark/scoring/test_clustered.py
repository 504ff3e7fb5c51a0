from __future__ import annotations

import numpy as np
import pytest

from benchmark.report.page import compare_paired
from benchmark.scoring.clustered import difference_interval, permutation_p
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
    # Two of ten flights lost: standard error sqrt(0.2 * 0.8 / 9), Student's t with 9 degrees 2.262.
    half = 226.2 * np.sqrt(0.2 * 0.8 / 9)
    assert together == pytest.approx((-20 - half, -20 + half), abs=0.02)
    assert apart == (pytest.approx(-25.5, abs=0.2), pytest.approx(-14.5, abs=0.2))


def test_flights_of_one_query_each_agree_with_the_normal_interval() -> None:
    rng = np.random.default_rng(0)
    before, after = (list(rng.random(400) < share) for share in (0.5, 0.6))
    low, high = difference_interval(before, after, [str(k) for k in range(400)]) or (0, 0)
    change = np.array(after, float) - np.array(before, float)
    half = 196 * change.std() / np.sqrt(400)
    assert low == pytest.approx(100 * change.mean() - half, abs=0.1)
    assert high == pytest.approx(100 * change.mean() + half, abs=0.1)


def test_one_course_says_nothing_about_others() -> None:
    before, after = [True] * 100, [k % 3 > 0 for k in range(100)]
    change = compare_paired(before, after, ["a"] * 100)
    assert (change["low"], change["high"], change["p"], change["courses"]) == (None, None, None, 1)
    assert change["change"] == -34


def test_two_courses_prove_nothing() -> None:
    """Of two courses that lose everything, two of four signs are as extreme."""
    courses = [str(k % 2) for k in range(100)]
    assert compare_paired([True] * 100, [False] * 100, courses)["p"] == 0.5
    before, after = [True] * 100, [k % 2 > 0 for k in range(100)]
    low, high = difference_interval(before, after, courses) or (0, 0)
    assert low == -100
    assert high == 100


def test_signs_are_the_same_at_every_run() -> None:
    queries = [k % 3 == 0 for k in range(60)]
    flights = [str(k % 30) for k in range(60)]
    drawn = {permutation_p(queries, queries[::-1], flights) for _ in range(3)}
    assert len(drawn) == 1


def test_the_permutation_test_exchanges_whole_flights() -> None:
    """Of eight flights that all lose five queries, two of 2^8 signs are as extreme."""
    flights = [f"flight-{k // 10}" for k in range(80)]
    after = [k % 10 >= 5 for k in range(80)]
    assert permutation_p([True] * 80, after, flights) == 2 / 2**8
    assert permutation_p(after, after, flights) == 1
    assert permutation_p([True] * 40, after[:40], flights[:40]) == 2 / 2**4
    assert permutation_p([True] * 10, after[:10], flights[:10]) is None


def test_p_of_many_flights_is_that_of_random_signs() -> None:
    """Flights of one query each: the test is McNemar's but for the draws."""
    before, after = [True] * 13 + [False] * 4, [False] * 13 + [True] * 4
    found = permutation_p(before, after, [str(k) for k in range(17)])
    assert found == pytest.approx(mcnemar(13, 4), abs=0.01)


def test_flights_that_differ_by_themselves_raise_no_false_alarm() -> None:
    """Twenty flights in which either method is better by chance: 5 % of p are below 0.05."""
    rng = np.random.default_rng(0)
    flights = [f"flight-{k // 28}" for k in range(560)]
    alarms, independent, covered = 0, 0, 0
    for _ in range(200):
        shares = 0.6 + rng.uniform(-0.3, 0.3, (2, 20)).repeat(28, axis=1)
        before, after = (rng.random((2, 560)) < shares).tolist()
        change = compare_paired(before, after, flights)
        alarms += change["p"] < 0.05
        independent += mcnemar(change["lost"], change["won"]) < 0.05
        covered += change["low"] <= 0 <= change["high"]
    assert 2 <= alarms <= 20
    assert 180 <= covered <= 198
    assert independent > 40  # one in five and more


def test_interval_of_flights_that_change_alike_is_not_a_point() -> None:
    flights = [f"flight-{k // 20}" for k in range(200)]
    before, after = [True] * 200, [k % 20 > 0 for k in range(200)]
    assert difference_interval(before, after, flights) == pytest.approx((-5, -5))
    change, apart = compare_paired(before, after, flights), compare(before, after)
    assert (change["low"], change["high"]) == pytest.approx((apart.low, apart.high), abs=0.01)


def test_mcnemar_is_two_sided() -> None:
    assert mcnemar(0, 0) == 1
    assert mcnemar(3, 3) == 1
    # 2 * (1 + 8) / 2^8
    assert mcnemar(1, 7) == mcnemar(7, 1) == pytest.approx(0.0703125)
