from __future__ import annotations

import time

import numpy as np
import pytest
import torch

from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Status, Stopwatch


def test_sigma_position_equals_a_monte_carlo_of_perturbed_poses() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6)) * 0.02
    covariance = root @ root.T
    # Far from the origin, where a wrong tangent would turn rotation into hundreds of metres.
    pose = Pose.from_quaternion([0.3, -0.5, 0.7, 0.2], [250.0, -400.0, 90.0])
    deltas = rng.multivariate_normal(np.zeros(6), covariance, 20_000)
    moved = (Pose.exp(torch.from_numpy(deltas)) @ pose).centre() - pose.centre()
    observed = float(moved.square().sum(-1).mean().sqrt())
    predicted = Estimate(Status.OK, pose, covariance).sigma_position()
    assert predicted == pytest.approx(observed, rel=0.02)


def test_no_covariance_no_sigma() -> None:
    assert Estimate(Status.FAILED, reason="no matches").sigma_position() is None


def test_status_is_the_word_of_the_results_file() -> None:
    assert [str(status) for status in Status] == ["ok", "fallback", "failed"]


def test_stopwatch_adds_up_stages_also_when_one_raises() -> None:
    clock = Stopwatch()
    with clock.stage("matching"):
        time.sleep(0.01)
    first = clock.seconds["matching"]
    with pytest.raises(RuntimeError), clock.stage("matching"):
        time.sleep(0.01)
        raise RuntimeError
    assert first >= 0.01
    assert clock.seconds["matching"] >= first + 0.01
    assert set(clock.seconds) == {"matching"}
