"""Honesty of covariances, held against scipy and against poses drawn from them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.stats import chi2

from benchmark.score import Threshold
from benchmark.uncertainty import _CHI2_95, consistency, normalised_error, risk_coverage
from scene.geometry.pose import Pose
from scene.localizer import Status
from tests.benchmark.made_data import pose_at, scored_query

TIGHT = Threshold(0.5, 5)


def drawn_errors(claimed: float) -> list[float]:
    """NEES of poses drawn with a covariance, of which `claimed` times as much is claimed."""
    rng = np.random.default_rng(0)
    spread = np.diag([1e-3, 2e-3, 1e-3, 0.2, 0.1, 0.4])
    mixed = spread @ (np.eye(6) + 0.3 * rng.standard_normal((6, 6)))
    covariance = mixed @ mixed.T
    reference = pose_at(2)
    values = []
    for error in rng.multivariate_normal(np.zeros(6), covariance, 3000):
        estimate = Pose.exp(torch.from_numpy(-error)) @ reference
        value = normalised_error(estimate, reference, claimed * covariance)
        assert value is not None
        values.append(value)
    return values


def test_an_honest_covariance_has_its_expectation() -> None:
    values = drawn_errors(1.0)
    assert np.mean(values) == pytest.approx(6, abs=4 * np.sqrt(12 / 3000))
    assert np.mean(np.array(values) <= _CHI2_95) == pytest.approx(0.95, abs=0.015)


def test_a_boastful_covariance_shows() -> None:
    assert np.mean(drawn_errors(0.25)) == pytest.approx(24, rel=0.06)


def test_quantile() -> None:
    assert pytest.approx(chi2.ppf(0.95, 6)) == _CHI2_95


@pytest.mark.parametrize(
    "covariance",
    [
        None,
        np.zeros((6, 6)),
        np.full((6, 6), np.nan),
        np.diag([1, 1, 1, 1, 1, -1.0]),
        np.diag([1, 1, 1, 1, 1, np.inf]),
    ],
)
def test_no_covariance_no_figure(covariance: np.ndarray | None) -> None:
    assert normalised_error(pose_at(1), pose_at(2), covariance) is None


def test_consistency_by_hand() -> None:
    queries = [
        scored_query("a", 0.1, nees=2.0),
        scored_query("b", 0.1, nees=4.0),
        scored_query("c", 0.1, nees=30.0),
        scored_query("d", 0.1),
        scored_query("e", 0.1, status=Status.FALLBACK, nees=1000.0),
        scored_query("f", None),
    ]
    found = consistency(queries)
    assert found is not None
    assert (found.queries, found.mean, found.median) == (3, 12.0, 4.0)
    assert found.within_95.value == pytest.approx(200 / 3)
    assert consistency(queries[3:]) is None


def test_risk_coverage_by_hand() -> None:
    queries = [
        scored_query("unsure and wrong", 3.0, sigma_t_m=2.0),
        scored_query("sure and right", 0.1, sigma_t_m=0.1),
        scored_query("failed", None),
        scored_query("fairly sure and right", 0.2, sigma_t_m=0.3),
    ]
    assert risk_coverage(queries, TIGHT) == [
        (25, 0),
        (50, 0),
        (75, pytest.approx(100 / 3)),
        (100, 50),
    ]
