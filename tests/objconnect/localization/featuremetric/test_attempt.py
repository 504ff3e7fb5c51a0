"""The covariance that an accepted pose is answered with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from objconnect.localization.align.aligner import Alignment
from objconnect.localization.align.covariance import PoseUncertainty
from objconnect.localization.featuremetric.attempt import Attempt, pose_covariance
from objconnect.localization.featuremetric.calibration import CovarianceModel
from objconnect.localization.featuremetric.options import SearchOptions
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import warp_image

NUMBERS = CovarianceModel(
    factor=2.0,
    patches_power=0.5,
    level=4e-4,
    level_patches=5.0,
    floor=1e-3,
    unchanged_fit=0.6,
    view_fit=0.5,
    changed_fit=0.2,
)
OPTIONS = SearchOptions(covariance=NUMBERS)
CAMERA = Camera.parse(["PINHOLE", "64", "64", "60", "60", "32", "32"])
DEPTH = 50.0
EQUAL = 15.0


def attempt(
    measured: float,
    fit: float,
    patches: float = 100,
    view_cosine: float = 1.0,
    informative_cost_ratio: float = 1.0,
    level: float = 4e-4,
) -> Attempt:
    """An attempt of which the alignment measured the same variance along each axis."""
    one = torch.ones(1, dtype=torch.float64)
    pose = Pose(torch.eye(3, dtype=torch.float64)[None], torch.zeros(1, 3, dtype=torch.float64))
    covariance = measured * torch.eye(6, dtype=torch.float64)[None]
    view = warp_image(np.zeros((64, 64, 3), np.uint8), CAMERA)
    alignment = Alignment(pose, (pose,), covariance, one, one, one, torch.zeros(1))
    uncertainty = PoseUncertainty(
        covariance,
        one,
        DEPTH * one,
        patches * one,
        view_cosine * one,
        informative_cost_ratio * one,
        level * one,
        EQUAL * one,
    )
    return Attempt(view, alignment, uncertainty, fit, None, 0.0)


def variances(tried: Attempt, options: SearchOptions = OPTIONS) -> NDArray[np.float64]:
    covariance = pose_covariance(tried, options)
    assert covariance is not None
    assert np.count_nonzero(covariance - np.diag(covariance.diagonal())) == 0
    return covariance.diagonal()


@pytest.mark.parametrize("fit", [0.3, 0.6])
def test_a_pose_is_less_sure_where_the_fit_is_worse(fit: float) -> None:
    np.testing.assert_allclose(variances(attempt(1e-4, fit)), 2.0 * fit / 0.6 * 1e-4)


def test_a_pose_is_less_sure_from_fewer_patches() -> None:
    np.testing.assert_allclose(variances(attempt(1e-4, 0.6, patches=25)), 2.0 * 2 * 1e-4)


@pytest.mark.parametrize(("level", "factor"), [(4e-4, 1), (8e-4, 7 / 8), (1e-4, 7 / 4), (0, 1)])
def test_a_level_of_few_patches_is_drawn_to_that_of_others(level: float, factor: float) -> None:
    """Of 15 patches of its own and 5 in general, a quarter is the level in general."""
    drawn = variances(attempt(1e-4, 0.6, level=level))
    np.testing.assert_allclose(drawn, 2.0 * factor * 1e-4)


@pytest.mark.parametrize(
    ("fit", "change"), [(0.4, 0.0), (0.6, 0.0), (0.66, 0.5), (0.72, 1.0), (0.9, 1.0)]
)
def test_what_moves_all_points_alike_is_added_where_the_fit_is_worse(
    fit: float, change: float
) -> None:
    added = variances(attempt(0.0, fit))
    np.testing.assert_allclose(added[:3], change * 1e-3**2, atol=1e-15)
    np.testing.assert_allclose(added[3:], change * (DEPTH * 1e-3) ** 2, atol=1e-12)


def test_a_worse_fit_of_another_view_is_no_change_of_season() -> None:
    """With a mean cosine of 0.8 the fit of the map's season is 0.6 + 0.5 * 0.2."""
    same, other = attempt(1e-4, 0.6), attempt(1e-4, 0.7, view_cosine=0.8)
    np.testing.assert_allclose(variances(other), variances(same))
    np.testing.assert_allclose(variances(other), 2.0 * 1e-4)
    assert (variances(attempt(1e-4, 0.7)) > variances(other)).all()


def test_the_fit_that_counts_is_that_of_the_points_that_tell_the_pose() -> None:
    tried = attempt(1e-4, 0.9, informative_cost_ratio=0.5)
    np.testing.assert_allclose(variances(tried), variances(attempt(1e-4, 0.45)))


def test_points_that_do_not_tell_the_pose_give_no_covariance() -> None:
    unknown = attempt(float("inf"), 0.5)
    assert pose_covariance(unknown, OPTIONS) is None
    assert pose_covariance(replace(unknown, uncertainty=None), OPTIONS) is None
