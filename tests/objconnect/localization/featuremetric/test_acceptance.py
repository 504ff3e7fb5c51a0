"""The probability that a pose is right."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from objconnect.localization.featuremetric.acceptance import (
    AcceptanceModel,
    best_probability,
    log_odds_of,
)
from objconnect.localization.featuremetric.evidence import Evidence
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Status

RIGHT = Evidence(peak=14.0, halves=0.05, curvature=0.9)
CHANGED = Evidence(peak=14.0, halves=0.2, curvature=0.5)
WRONG = Evidence(peak=3.5, halves=1.5, curvature=0.1)


def pose(east: float) -> Pose:
    eye = torch.eye(3, dtype=torch.float64)
    return Pose(eye, torch.tensor([-east, 0, 0], dtype=torch.float64))


def test_the_shipped_model_tells_right_from_wrong() -> None:
    model = AcceptanceModel.load_beside(None)
    assert model.alignment_log_odds(RIGHT) > model.alignment_log_odds(CHANGED) > log_odds_of(0.95)
    assert model.alignment_log_odds(WRONG) < log_odds_of(0.05)
    assert (
        model.match_log_odds(100) > log_odds_of(0.99) > log_odds_of(0.5) > model.match_log_odds(4)
    )
    assert model.match_log_odds(0) == -math.inf


@pytest.mark.parametrize(
    "broken",
    [{field: bad} for field in vars(RIGHT) for bad in (math.inf, -math.inf, math.nan, 0.0)],
)
def test_evidence_without_a_bound_has_bounded_odds(broken: dict[str, float]) -> None:
    told = Evidence(**{**vars(WRONG), **broken})
    assert math.isfinite(AcceptanceModel.load_beside(None).alignment_log_odds(told))


@pytest.mark.parametrize("field", vars(RIGHT))
def test_evidence_that_is_no_number_is_no_evidence(field: str) -> None:
    model = AcceptanceModel.load_beside(None)
    told = Evidence(**{**vars(RIGHT), field: math.nan})
    assert model.alignment_log_odds(told) < model.alignment_log_odds(CHANGED)


@pytest.mark.parametrize("probability", [1e-6, 0.3, 0.999])
def test_log_odds_are_those_of_the_probability(probability: float) -> None:
    assert 1 / (1 + math.exp(-log_odds_of(probability))) == pytest.approx(probability)


def test_one_place_alone_has_its_own_probability() -> None:
    best, probability = best_probability([(pose(0), log_odds_of(0.8))])
    assert best == 0 and probability == pytest.approx(0.8)


def test_two_places_that_fit_as_well_have_half_each_at_most() -> None:
    best, probability = best_probability([(pose(0), 6.0), (pose(40), 6.0), (pose(80), -9.0)])
    assert best == 0 and 0.49 < probability < 0.5


def test_poses_of_one_place_count_once() -> None:
    once = best_probability([(pose(0.1), 6.0), (pose(40), -1.0)])[1]
    many = [(pose(0.2), 4.0), (pose(0.1), 6.0), (pose(40), -1.0), (pose(40.3), -2.0)]
    best, probability = best_probability(many)
    assert best == 1 and probability == pytest.approx(once)


def test_a_rival_takes_from_the_probability_but_is_not_chosen() -> None:
    assert best_probability([(pose(0), 4.0)], [(pose(40), 4.0)])[1] < 0.5
    best, probability = best_probability([(pose(0), 4.0)], [(pose(40), 9.0)])
    assert best == 0 and probability < 0.01
    alone = best_probability([(pose(0), 4.0)])
    assert best_probability([(pose(0), 4.0)], [(pose(0.3), 9.0)]) == alone


def test_where_all_failed_nothing_is_probable() -> None:
    assert best_probability([(pose(0), -math.inf), (pose(3), -math.inf)])[1] == 0.0


def test_certain_poses_do_not_overflow() -> None:
    assert best_probability([(pose(0), log_odds_of(1.0)), (pose(9), -math.inf)])[1] <= 1


def test_matches_that_found_nothing_are_not_rated() -> None:
    model = AcceptanceModel.load_beside(None)
    lost = Estimate(Status.FALLBACK, pose(0), inliers=500)
    assert model.rate(lost).probability is None
    found = model.rate(Estimate(Status.OK, pose(0), np.eye(6), inliers=500))
    assert found.probability is not None and found.probability > 0.99


def test_an_inexact_pose_from_many_matches_is_not_sure_to_be_right() -> None:
    """Of errors with a standard deviation of 10 m, 38 % are below 5 m."""
    model = AcceptanceModel.load_beside(None)
    covariance = np.diag([1e-6] * 3 + [0.0, 0.0, 100.0])
    found = model.rate(Estimate(Status.OK, pose(0), covariance, inliers=500))
    assert found.probability == pytest.approx(0.383, abs=0.001)


def test_weights_of_a_user_have_a_model_of_their_own(tmp_path: Path) -> None:
    weights = tmp_path / "own.safetensors"
    shipped = AcceptanceModel.load_beside(weights)
    assert shipped == AcceptanceModel.load_beside(None)
    numbers = shipped.model_dump() | {"matched": {"bias": -1.0, "inliers": 2.0}}
    AcceptanceModel.path_beside(weights).write_text(str(numbers).replace("'", '"'))
    assert AcceptanceModel.load_beside(weights) == AcceptanceModel.model_validate(numbers)
    AcceptanceModel.path_beside(weights).write_text("aligned: 3")
    with pytest.raises(InputError, match="aligned"):
        AcceptanceModel.load_beside(weights)
    AcceptanceModel.path_beside(weights).unlink()
    AcceptanceModel.path_beside(weights).mkdir()
    with pytest.raises(InputError, match="cannot read"):
        AcceptanceModel.load_beside(weights)
