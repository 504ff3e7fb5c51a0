from __future__ import annotations

from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from benchmark.scoring.intervals import wilson
from benchmark.scoring.score import THRESHOLDS, Threshold, is_correct, median_errors, recall
from objconnect.scene.localizer import Status


@dataclass(frozen=True)
class Scored:
    status: Status
    t_err_m: float | None
    r_err_deg: float | None
    course_name: str = "a"


def ok(metres: float, degrees: float) -> Scored:
    return Scored(Status.OK, metres, degrees)


FAILED = Scored(Status.FAILED, None, None)

errors = st.floats(0, 20)
with_pose = st.builds(Scored, st.sampled_from([Status.OK, Status.FALLBACK]), errors, errors)
outcomes = st.lists(st.one_of(with_pose, st.just(FAILED)), min_size=1, max_size=40)


def test_thresholds_are_the_published_three() -> None:
    assert [threshold.key for threshold in THRESHOLDS] == ["0.25m_2deg", "0.5m_5deg", "5m_10deg"]


@pytest.mark.parametrize(
    ("metres", "degrees", "expected"),
    [
        (0.2499999, 1.9999999, True),
        (0.25, 1.0, False),
        (0.1, 2.0, False),
        (0.0, 0.0, True),
    ],
)
def test_both_thresholds_are_strict(metres: float, degrees: float, expected: bool) -> None:
    assert is_correct(ok(metres, degrees), Threshold(0.25, 2)) is expected


def test_recall_equals_a_hand_computed_one() -> None:
    scored = [ok(0.1, 0.1), ok(0.3, 0.1), ok(0.1, 6), FAILED, Scored(Status.FALLBACK, 0.0, 0.0)]
    assert [recall(scored, threshold).value for threshold in THRESHOLDS] == [20, 40, 60]


def test_fallback_at_the_reference_pose_is_wrong() -> None:
    assert not is_correct(Scored(Status.FALLBACK, 0.0, 0.0), Threshold(5, 10))


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        # Wilson (1927) by hand with z = 1.96: centre 0.5, half-width 0.2983 for five of ten.
        (5, 10, 0.2366, 0.7634),
        (0, 10, 0.0, 0.2775),
        (10, 10, 0.7225, 1.0),
        (1, 1, 0.2065, 1.0),
    ],
)
def test_wilson_equals_a_hand_computed_interval(
    successes: int, trials: int, low: float, high: float
) -> None:
    assert wilson(successes, trials) == pytest.approx((low, high), abs=5e-5)


@given(st.integers(1, 2000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_contains_the_proportion(counts: tuple[int, int]) -> None:
    successes, trials = counts
    low, high = wilson(successes, trials)
    assert 0 <= low <= successes / trials <= high <= 1
    mirrored = wilson(trials - successes, trials)
    assert (1 - high, 1 - low) == pytest.approx(mirrored, abs=1e-12)


@given(st.integers(1, 500))
def test_wilson_narrows_with_more_queries(trials: int) -> None:
    low, high = wilson(trials, 2 * trials)
    tighter_low, tighter_high = wilson(2 * trials, 4 * trials)
    assert low < tighter_low < tighter_high < high


@given(outcomes, errors, errors, errors, errors)
def test_recall_grows_with_the_threshold(
    scored: list[Scored], metres: float, degrees: float, more: float, wider: float
) -> None:
    narrow = recall(scored, Threshold(metres, degrees)).value
    assert narrow <= recall(scored, Threshold(metres + more, degrees + wider)).value


@given(outcomes)
def test_a_failed_query_only_lowers_recall(scored: list[Scored]) -> None:
    for threshold in THRESHOLDS:
        before = recall(scored, threshold).value
        after = recall([*scored, FAILED], threshold).value
        assert after == pytest.approx(before * len(scored) / (len(scored) + 1))


def test_medians_are_over_poses() -> None:
    assert median_errors([ok(1, 10), ok(3, 30), FAILED, Scored(Status.FALLBACK, 8, 2)]) == (3, 10)
    assert median_errors([ok(1, 10), ok(3, 30)]) == (2, 20)
    assert median_errors([FAILED]) == (None, None)


@given(st.integers(1, 400).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_agrees_with_scipy(counts: tuple[int, int]) -> None:
    expected = binomtest(*counts).proportion_ci(0.95, method="wilson")
    assert wilson(*counts) == pytest.approx((expected.low, expected.high), abs=1e-12)
