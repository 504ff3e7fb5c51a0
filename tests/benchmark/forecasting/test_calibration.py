"""Pooling and the logistic model, against numbers of the test's own."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.forecasting.calibration import (
    UNCALIBRATED,
    Calibration,
    ViewResult,
    calibration_of,
    false_risk,
    features,
    fit,
    pool,
    probability,
)

NAN = float("nan")
CENTRES = np.array([[0.0, 0.0, 60.0], [20.0, 0.0, 60.0], [500.0, 0.0, 60.0]])
SEEN = [
    ViewResult(0, True, False, 50, 100, 0.2, 0.1),
    ViewResult(1, False, True, 6, 40, 3.0, 2.0),
    ViewResult(2, False, False, 0, 10, NAN, NAN),
]


def test_a_neighbour_at_the_pooling_distance_counts_61_percent() -> None:
    evidence = pool(SEEN, CENTRES)
    near = np.exp(-0.5)
    np.testing.assert_allclose(evidence.views, [1 + near, 1 + near, 1.0])
    np.testing.assert_allclose(evidence.found, [1.0, near, 0.0], atol=1e-12)
    np.testing.assert_allclose(evidence.false, [near, 1.0, 0.0], atol=1e-12)
    inliers = (np.log(51) + near * np.log(7)) / (1 + near)
    assert evidence.inliers[0] == pytest.approx(inliers)
    assert evidence.points[2] == pytest.approx(np.log(11))
    # Only fixes tell a sigma, and none is near the last waypoint.
    np.testing.assert_allclose(evidence.sigma_across_m[:2], 0.2)
    assert np.isnan(evidence.sigma_across_m[2])


def test_without_a_calibration_the_probability_is_the_smoothed_share() -> None:
    evidence = pool(SEEN, CENTRES)
    share = (evidence.found + 0.5) / (evidence.views + 1)
    np.testing.assert_allclose(probability(evidence, UNCALIBRATED), share)
    assert probability(evidence, UNCALIBRATED)[2] == pytest.approx(0.25), "never 0 or 1"


def test_risk_is_drawn_to_the_usual_share_of_false_fixes() -> None:
    evidence = pool(SEEN, CENTRES)
    usual = Calibration(weights=(0, 1, 0, 0), false_share=0.1)
    near = np.exp(-0.5)
    assert false_risk(evidence, usual)[0] == pytest.approx((near + 0.6) / (1 + near + 6))
    assert false_risk(evidence, usual)[2] == pytest.approx(0.6 / 7)


def test_the_fit_finds_weights_that_made_the_data() -> None:
    rng = np.random.default_rng(3)
    rows = np.column_stack([np.ones(4000), rng.normal(size=(4000, 3))])
    true = np.array([-0.4, 1.6, 0.8, -0.5])
    happened = rng.random(4000) < 1 / (1 + np.exp(-rows @ true))
    np.testing.assert_allclose(fit(rows, happened), true, atol=0.2)


def test_the_fit_stays_at_the_smoothed_share_with_little_data() -> None:
    rows = np.array([[1.0, 0.5, 0.0, 0.0], [1.0, -0.5, 0.0, 0.0]])
    constant, share, inliers, points = fit(rows, np.array([True, False]))
    assert abs(constant) < 0.1 and share == pytest.approx(1.0, abs=0.2)
    assert (inliers, points) == (0.0, 0.0)


def test_the_fit_ends_where_classes_are_apart() -> None:
    rows = np.column_stack([np.ones(200), np.repeat([-3.0, 3.0], 100), np.zeros((200, 2))])
    weights = fit(rows, rows[:, 1] > 0)
    assert np.isfinite(weights).all() and weights[1] > 1


@pytest.mark.parametrize("method", ["sift", "objconnect"])
def test_the_project_has_a_calibration_of_training_towns_alone(method: str) -> None:
    shipped = calibration_of(method)
    assert shipped.queries >= 60
    seeds = [int(name.strip().lstrip("I")) for name in shipped.source.split(",")]
    assert min(seeds) >= 1000
    assert calibration_of(method, wanted=False) == UNCALIBRATED
    assert calibration_of("nobody's") == UNCALIBRATED


def test_more_evidence_gives_a_higher_calibrated_probability() -> None:
    evidence = pool(SEEN, CENTRES)
    chances = probability(evidence, calibration_of("sift"))
    assert chances[0] > chances[1] > chances[2]
    assert features(evidence).shape == (3, 4)
