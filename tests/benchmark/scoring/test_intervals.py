from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from benchmark.scoring.intervals import mean_interval, share, share_of_counts, wilson


def simulate_counts(
    rng: np.random.Generator, courses: int, size: int, recall: float, correlation: float
) -> NDArray[np.float64]:
    """Right queries of each course, whose recalls are drawn from a beta distribution."""
    spread = (1 - correlation) / correlation
    recalls = rng.beta(recall * spread, (1 - recall) * spread, courses)
    return rng.binomial(size, recalls).astype(np.float64)


@pytest.mark.parametrize(("courses", "recall"), [(7, 0.7), (14, 0.9), (14, 0.5), (28, 0.95)])
def test_intervals_by_course_cover_the_truth(courses: int, recall: float) -> None:
    """400 experiments whose courses of 200 queries differ by about five points of recall."""
    rng = np.random.default_rng(0)
    size = np.full(courses, 200)
    covered = independent = 0
    for _ in range(400):
        right = simulate_counts(rng, courses, 200, recall, 0.03)
        found = share_of_counts(right, size)
        assert found.low is not None
        assert found.high is not None
        covered += found.low <= 100 * recall <= found.high
        low, high = wilson(right.sum(), size.sum())
        independent += low <= recall <= high
    # 95 % of 400 within three standard deviations; as independent queries it is about half.
    assert 367 <= covered <= 393
    assert independent < 280


def test_independent_queries_have_nearly_wilsons_interval() -> None:
    """Many courses of one query each: the design effect is 1 and Student's t is the normal's."""
    right = np.random.default_rng(1).random(3000) < 0.9
    found = share(right, [str(k) for k in range(3000)])
    low, high = wilson(int(right.sum()), 3000)
    assert (found.low, found.high) == pytest.approx((100 * low, 100 * high), abs=0.02)


def test_courses_that_fail_as_a_whole_count_as_one_query_each() -> None:
    """Of ten courses two fail: as ten queries, but for the k / (k - 1) and Student's t."""
    right, courses = [k // 30 > 1 for k in range(300)], [str(k // 30) for k in range(300)]
    found = share(right, courses)
    effective = 300 / (10 / 9 * 30) * (1.959964 / stats.t.ppf(0.975, 9)) ** 2
    low, high = wilson(0.8 * effective, effective)
    assert found == pytest.approx((80, 100 * low, 100 * high), abs=1e-3)
    assert found.low is not None
    assert found.low < 46


def test_one_course_has_no_interval() -> None:
    found = share([True, True, False, True], ["a"] * 4)
    assert found == (75, None, None)
    assert found.text() == "75.0 [–]"
    assert share([True] * 4, ["a"] * 4).text() == "100.0 [–]"


@pytest.mark.parametrize("right", [True, False])
def test_where_all_agree_the_interval_is_not_a_point(right: bool) -> None:
    """Correlation is unknown then; few courses still widen the interval."""
    ends = {}
    for courses in (2, 14):
        found = share([right] * 280, [str(k % courses) for k in range(280)])
        assert found.value == 100 * right
        assert found.low is not None
        assert found.high is not None
        ends[courses] = found.high - found.low
        assert 0 <= found.low <= found.value <= found.high <= 100
    assert 0 < ends[14] < 2 < 20 < ends[2]


def test_the_interval_is_never_narrower_than_that_of_independent_queries() -> None:
    """Courses that happen to agree better than chance are not evidence."""
    found = share([k % 10 > 0 for k in range(400)], [str(k // 20) for k in range(400)])
    low, high = wilson(360, 400)
    assert found.low is not None
    assert found.high is not None
    assert found.low < 100 * low
    assert found.high > 100 * high


def test_uneven_courses_count_by_their_queries() -> None:
    """A course of one query changes little, whatever its outcome."""
    courses = ["a"] * 100 + ["b"] * 100 + ["c"]
    right = [k % 5 > 0 for k in range(200)]
    with_right, with_wrong = share([*right, True], courses), share([*right, False], courses)
    assert with_right.low is not None
    assert with_wrong.low is not None
    assert abs(with_right.low - with_wrong.low) < 1.5


def test_the_interval_of_a_mean_covers_the_truth_by_course() -> None:
    """400 experiments of 14 courses of 100 figures, whose means differ by half of what they
    spread within; as independent figures the interval covers about half."""
    rng = np.random.default_rng(0)
    courses = [str(k // 100) for k in range(1400)]
    covered = independent = 0
    for _ in range(400):
        values = 6 + 0.5 * np.repeat(rng.standard_normal(14), 100) + rng.standard_normal(1400)
        ends = mean_interval(values, courses)
        assert ends is not None
        covered += ends[0] <= 6 <= ends[1]
        half = 1.96 * values.std() / np.sqrt(1400)
        independent += abs(values.mean() - 6) <= half
    assert 367 <= covered <= 393
    assert independent < 280
    assert mean_interval([1.0, 2.0], ["a", "a"]) is None


def test_courses_of_one_figure_have_students_interval() -> None:
    values = np.random.default_rng(2).normal(6, 3, 12)
    ends = mean_interval(values, [str(k) for k in range(12)])
    expected = stats.t.interval(0.95, 11, values.mean(), stats.sem(values))
    assert ends == pytest.approx(expected)
