"""Honesty of covariances, held against scipy and against poses drawn from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import chi2

from benchmark.scoring.score import Threshold
from benchmark.scoring.uncertainty import (
    _CHI2_95,
    compute_nees,
    consistency,
    doubt,
    risk_coverage,
)
from experiments.covariance import Answers, calibrate
from objconnect.localization.align.covariance import PoseUncertainty
from objconnect.localization.featuremetric.calibration import CovarianceModel
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Status
from tests.benchmark.made_data import make_scored_query, pose_at

TIGHT = Threshold(0.5, 5)


def draw_errors(claimed: float, count: int) -> list[float]:
    """NEES of poses drawn with a covariance, of which `claimed` times as much is claimed."""
    rng = np.random.default_rng(0)
    spread = np.diag([1e-3, 2e-3, 1e-3, 0.2, 0.1, 0.4])
    mixed = spread @ (np.eye(6) + 0.3 * rng.standard_normal((6, 6)))
    covariance = mixed @ mixed.T
    reference = pose_at(2)
    errors = rng.multivariate_normal(np.zeros(6), covariance, count)
    estimates = Pose.exp(torch.from_numpy(-errors)) @ reference
    values = []
    for rotation, translation in zip(estimates.rotation, estimates.translation, strict=True):
        value = compute_nees(Pose(rotation, translation), reference, claimed * covariance)
        assert value is not None
        values.append(value)
    return values


def test_an_honest_covariance_has_its_expectation() -> None:
    values = draw_errors(1.0, 3000)
    assert np.mean(values) == pytest.approx(6, abs=4 * np.sqrt(12 / 3000))
    assert np.mean(np.array(values) <= _CHI2_95) == pytest.approx(0.95, abs=0.015)


def test_a_boastful_covariance_shows() -> None:
    assert np.mean(draw_errors(0.25, 1000)) == pytest.approx(24, rel=0.06)


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
    assert compute_nees(pose_at(1), pose_at(2), covariance) is None


def test_consistency_by_hand() -> None:
    queries = [
        make_scored_query("a", 0.1, nees=2.0),
        make_scored_query("b", 0.1, nees=4.0),
        make_scored_query("c", 0.1, nees=30.0),
        make_scored_query("d", 0.1),
        make_scored_query("e", 0.1, status=Status.FALLBACK, nees=1000.0),
        make_scored_query("f", None),
    ]
    found = consistency(queries)
    assert found is not None
    assert (found.queries, found.mean, found.median) == (3, 12.0, 4.0)
    assert found.within_95.value == pytest.approx(200 / 3)
    assert consistency(queries[3:]) is None


def test_risk_coverage_by_hand() -> None:
    queries = [
        make_scored_query("unsure and wrong", 3.0, sigma_t_m=2.0),
        make_scored_query("sure and right", 0.1, sigma_t_m=0.1),
        make_scored_query("failed", None),
        make_scored_query("fairly sure and right", 0.2, sigma_t_m=0.3),
    ]
    assert risk_coverage(queries, TIGHT) == [
        (25, 0),
        (50, 0),
        (75, pytest.approx(100 / 3)),
        (100, 50),
    ]


def test_a_predicted_probability_goes_before_a_sigma() -> None:
    queries = [
        make_scored_query("unlikely and wrong", 3.0, sigma_t_m=0.1, probability=0.6),
        make_scored_query("likely and right", 0.1, sigma_t_m=0.9, probability=0.999),
        make_scored_query("as likely, and surer", 0.2, sigma_t_m=0.3, probability=0.999),
        make_scored_query("failed", None, probability=0.2),
    ]
    order = [query.name for query in sorted(queries, key=doubt)]
    assert order == ["as likely, and surer", "likely and right", "unlikely and wrong", "failed"]
    assert risk_coverage(queries, TIGHT)[1] == (50, 0)


def make_answers(
    numbers: CovarianceModel, seed: int, count: int = 2000, freedom: int = 8
) -> Answers:
    """Errors of Student's distribution that have the covariances that the numbers give."""
    rng = np.random.default_rng(seed)
    mixed = rng.normal(size=(count, 6, 9)) * np.repeat([3e-4, 2e-2], 3)[:, None]
    covariances = mixed @ mixed.transpose(0, 2, 1) / 9
    depth, patches = rng.uniform(30, 120, count), rng.uniform(50, 500, count)
    fit, view_cosine = rng.uniform(0.5, 0.9, count), rng.uniform(0.8, 1.0, count)
    level, equal = np.exp(rng.normal(np.log(5e-4), 0.5, count)), rng.uniform(5, 30, count)
    same = np.ones(count)
    columns = (same, depth, patches, view_cosine, same, level, equal)
    around = PoseUncertainty(torch.from_numpy(covariances), *map(torch.from_numpy, columns))
    names = np.full(count, "snow")
    known = Answers(names, names, np.zeros((count, 6)), around, fit, np.zeros(count, bool))
    lower = np.linalg.cholesky(known.covariances(numbers))
    tails = np.sqrt((freedom - 2) / rng.chisquare(freedom, count))
    errors = (lower @ rng.normal(size=(count, 6, 1)))[..., 0] * tails[:, None]
    return replace(known, errors=errors)


@pytest.mark.parametrize(
    "planted",
    [
        CovarianceModel.from_values((2.0, 0.2, 5e-4, 4, 3e-4, 0.6, 0.4, 0.1)),
        CovarianceModel.from_values((3.0, 0.5, 8e-4, 8, 6e-4, 0.65, 0.8, 0.2)),
    ],
)
@pytest.mark.thorough  # the next test holds covariances that are calibrated by fewer answers
def test_calibration_finds_what_was_planted(planted: CovarianceModel) -> None:
    found = calibrate(make_answers(planted, seed=1, count=5000))
    assert found.patches_power == pytest.approx(planted.patches_power, abs=0.1)
    assert found.factor == pytest.approx(planted.factor, rel=0.1)
    assert found.floor == pytest.approx(planted.floor, rel=0.1)
    assert found.unchanged_fit == pytest.approx(planted.unchanged_fit, abs=0.05)
    assert found.view_fit == pytest.approx(planted.view_fit, abs=0.15)
    assert found.changed_fit == pytest.approx(planted.changed_fit, abs=0.05)


def test_calibrated_covariances_hold_where_they_were_not_chosen() -> None:
    planted = CovarianceModel.from_values((2.0, 0.2, 5e-4, 4, 3e-4, 0.6, 0.4, 0.1))
    found = calibrate(make_answers(planted, seed=1, freedom=20))
    unseen = make_answers(planted, seed=2, freedom=20)
    for wrong, holds in [(1.0, True), (2.0, False), (0.5, False)]:
        changed = {"factor": found.factor * wrong, "floor": found.floor * wrong**0.5}
        off = found.model_copy(update=changed)
        nees = unseen.nees(off)
        held = 4.5 < nees.mean() < 8 and 0.93 <= np.mean(nees <= _CHI2_95) <= 0.97
        assert held == holds, wrong
