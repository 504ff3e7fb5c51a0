"""Every statistic of the reports on one hand-made result set, held against scipy or a closed form.

Two methods on sixty queries of six flights. The second loses seven of the first and wins two.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from benchmark.results.query_result import QueryResult
from benchmark.results.results import DatasetId, Results
from benchmark.scoring.clustered import difference_interval
from benchmark.scoring.paired import compare, mcnemar
from benchmark.scoring.score import THRESHOLDS, is_correct
from benchmark.scoring.uncertainty import risk_coverage
from objconnect.localization.provenance import Method
from objconnect.scene.localizer import Status
from tests.benchmark.made_data import make_scored_query

TIGHT, MIDDLE, WIDE = THRESHOLDS
LOST, WON = (3, 4, 5, 13, 14, 23, 33), (50, 51)


def make(error_m: dict[int, float | None], name: str) -> Results:
    """Sixty queries 0.1 m off, flight by flight of ten, but for those of `error_m`; None failed."""
    queries: list[QueryResult] = []
    for k in range(60):
        metres = error_m.get(k, 0.1)
        queries.append(
            make_scored_query(
                f"{k:02d}",
                metres,
                "summer" if k < 30 else "winter",
                group=f"flight {k // 10}",
                altitude_m=25.0 + k,
                nees=None if metres is None else 0.5 * k,
                sigma_t_m=None if metres is None else 0.01 * (k + 1),
                seconds={"total": 0.1 * (k + 1)},
            )
        )
    queries[59] = make_scored_query("59", 0.1, "winter", Status.FALLBACK, group="flight 5")
    return Results.of(
        Method(name=name, config={}, weights_sha256=None),
        DatasetId(name="d", track="uav-sim", sha256="a" * 64, map_conditions=("summer",)),
        "prior",
        queries,
    )


# Queries 50 and 51 of the first are 0.4 m off, 52 fails; the second finds them.
FIRST = make({50: 0.4, 51: 0.4, 52: None}, "first")
SECOND = make(dict.fromkeys(LOST, 7.0) | {52: None}, "second")


def right(results: Results) -> list[bool]:
    return [is_correct(query, TIGHT) for query in results.queries]


def interval_by_flight(counted: list[bool], flights: list[str]) -> list[float]:
    """Wilson's interval in percent as the roots of his equation, by the mean of each flight.

    The effective number of queries is that whose binomial variance is the one of the mean of the
    flights, here of one size, for Student's t instead of the normal quantile.
    """
    of = np.array(
        [
            np.mean([c for c, f in zip(counted, flights, strict=True) if f == flight])
            for flight in dict.fromkeys(flights)
        ]
    )
    p, n, k = np.mean(counted), len(counted), len(of)
    variance = max(of.var(ddof=1) / k, p * (1 - p) / n)
    n *= p * (1 - p) / n / variance * (stats.norm.ppf(0.975) / stats.t.ppf(0.975, k - 1)) ** 2
    z = stats.norm.ppf(0.975) ** 2 / n
    return sorted(100 * np.roots([1 + z, -2 * p - z, p * p]))


@pytest.mark.parametrize(("results", "correct"), [(FIRST, (56, 58, 58)), (SECOND, (51, 51, 51))])
def test_recall_and_its_interval_are_right(results: Results, correct: tuple[int, int, int]) -> None:
    for threshold, count in zip(THRESHOLDS, correct, strict=True):
        found = results.summary.recall[threshold.key]
        counted = [is_correct(query, threshold) for query in results.queries]
        expected = interval_by_flight(counted, [query.group for query in results.queries])
        assert found.value == pytest.approx(100 * count / 60)
        assert [found.low, found.high] == pytest.approx(expected)
    assert results.summary.courses == 6


def test_medians_failures_and_seconds_are_right() -> None:
    errors = [q.t_err_m for q in SECOND.queries if q.t_err_m is not None]
    assert len(errors) == 59
    assert SECOND.summary.median_t_m == np.median(errors) == 0.1
    assert (SECOND.summary.failed, SECOND.summary.fallback) == (1, 1)
    # 0.1 s, 0.2 s ... 5.9 s, and 0.25 s of the last.
    assert SECOND.summary.seconds.per_query["total"] == pytest.approx((177 + 0.25) / 60)


def test_parts_have_the_figures_of_their_queries() -> None:
    assert {n: part.queries for n, part in FIRST.by_condition.items()} == {
        "summer": 30,
        "winter": 30,
    }
    assert FIRST.by_group["flight 5"].recall[TIGHT.key].value == 60
    assert FIRST.by_group["flight 0"].recall[TIGHT.key].value == 100
    # From 25 m to 83 m, and the last at 70 m.
    assert {n: part.queries for n, part in FIRST.by_altitude.items()} == {
        "0-30 m": 5,
        "30-60 m": 30,
        "60-90 m": 25,
    }


def test_covariance_figures_are_right() -> None:
    """NEES of 0, 0.5, 1 ... over the localized queries, of which 52 has none."""
    values = np.array([0.5 * k for k in range(59) if k != 52])
    found = FIRST.summary.uncertainty
    assert found is not None
    assert (found.queries, found.nees_mean) == (58, pytest.approx(values.mean()))
    assert found.nees_median == pytest.approx(np.median(values))
    inside = int((values <= stats.chi2.ppf(0.95, 6)).sum())
    assert inside == 26
    # The first 26 of the flights' 10, 10, 10, 10, 10 and 8 queries.
    right, size = np.array([10, 10, 6, 0, 0, 0]), np.array([10, 10, 10, 10, 10, 8])
    p, t = inside / 58, stats.t.ppf(0.975, 5)
    variance = 6 / 5 * np.square(right - p * size).sum() / 58**2
    assert variance > p * (1 - p) / 58
    # Wilson (1927): his equation holds at both ends, at t standard errors.
    for end in (found.within_95.low, found.within_95.high):
        assert end is not None
        scale = end / 100 * (1 - end / 100) / (p * (1 - p))
        assert (p - end / 100) ** 2 == pytest.approx(t**2 * variance * scale)
    assert found.within_95.value == pytest.approx(100 * inside / 58)


def test_the_risk_coverage_curve_is_right() -> None:
    """Sigmas grow with the number, so of the first k + 1 the wrong ones are those of LOST below."""
    curve = risk_coverage(SECOND.queries, TIGHT)
    for k in range(50):
        wrong = sum(lost <= k for lost in LOST)
        assert curve[k] == pytest.approx((100 * (k + 1) / 60, 100 * wrong / (k + 1)))
    assert curve[-1] == pytest.approx((100, 100 * 9 / 60))


def test_the_paired_comparison_is_right() -> None:
    change = compare(right(FIRST), right(SECOND))
    assert (change.lost, change.won) == (len(LOST), len(WON))
    assert change.change == pytest.approx(-100 * 5 / 60)
    assert change.p_drop == pytest.approx(stats.binomtest(7, 9, alternative="greater").pvalue)
    assert mcnemar(7, 2) == pytest.approx(stats.binomtest(7, 9).pvalue)
    # 2.0**1024 is more than a float can hold.
    assert mcnemar(640, 560) == pytest.approx(stats.binomtest(640, 1200).pvalue)
    assert 0 <= mcnemar(3000, 0) < 1e-300
    # Bonett and Price: both counts and half of the others one larger, then Wald.
    p, q, z = 8 / 62, 3 / 62, stats.norm.ppf(0.975)
    half = z * np.sqrt((p + q - (p - q) ** 2) / 62)
    assert (change.low, change.high) == pytest.approx((100 * (q - p - half), 100 * (q - p + half)))


def test_the_interval_of_the_change_is_that_of_the_flights() -> None:
    before, after = right(FIRST), right(SECOND)
    flights = [query.group for query in FIRST.queries]
    found = difference_interval(before, after, flights)
    # Flights are of one size: the change of recall is the mean of theirs.
    changes = np.subtract(after, before, dtype=float).reshape(6, 10).mean(1) * 100
    expected = stats.ttest_1samp(changes, 0).confidence_interval(0.95)
    assert found == pytest.approx((expected.low, expected.high))
