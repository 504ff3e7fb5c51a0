"""A method of another package may return or raise anything; each query then has a reason."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from objconnect.localization.pipeline.failures import localize_safely
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Localizer, Query, Status

QUERY = Query(
    "a.jpg", np.zeros((8, 8, 3), np.uint8), Camera("SIMPLE_PINHOLE", 8, 8, (8.0, 4.0, 4.0))
)
POSE = Pose(torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))
FOUND = Estimate(Status.OK, POSE, np.eye(6), inliers=9, seconds={"all": 0.1}, probability=0.9)
BATCH = Pose(POSE.rotation[None], POSE.translation[None])
FLIP = torch.diag(torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64))


def localize(answer: Callable[[Query], Any]) -> Estimate:
    class Plugin:
        name = "plugin"

        def localize(self, query: Query) -> Any:
            return answer(query)

    method: Any = Plugin()
    given: Localizer = method
    return localize_safely(given, QUERY)


def test_a_valid_estimate_is_passed_on() -> None:
    for valid in (
        FOUND,
        Estimate(Status.FAILED, reason="no match"),
        replace(FOUND, covariance=None),
    ):
        assert localize(lambda _, valid=valid: valid) is valid


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (np.zeros(7), "returned ndarray instead of Estimate"),
        (None, "returned NoneType instead of Estimate"),
        (replace(FOUND, status="good"), "no Status"),
        (replace(FOUND, cam_from_world=None), "without a pose"),
        (replace(FOUND, cam_from_world=np.eye(4)), "ndarray instead of Pose"),
        (replace(FOUND, cam_from_world=Pose(FLIP, POSE.translation)), "no rotation matrix"),
        (replace(FOUND, cam_from_world=Pose(2 * POSE.rotation, POSE.translation)), "no rotation"),
        (
            replace(FOUND, cam_from_world=Pose(POSE.rotation[None], POSE.translation[None])),
            "single",
        ),
        (replace(FOUND, cam_from_world=Pose(POSE.rotation, POSE.translation / 0)), "not finite"),
        (replace(FOUND, covariance=np.eye(3)), r"shape \(3, 3\)"),
        (replace(FOUND, probability=-3.0), "probability -3"),
        (replace(FOUND, probability=float("nan")), "probability nan"),
        (replace(FOUND, seconds={"all": float("nan")}), "seconds"),
        (replace(FOUND, inliers=-5), "inliers"),
        (replace(FOUND, iterations=2.5), "iterations"),
    ],
)
def test_a_result_that_is_no_estimate_is_a_failure(answer: object, reason: str) -> None:
    found = localize(lambda _: answer)
    assert found.status is Status.FAILED and found.cam_from_world is None
    assert re.search(reason, found.reason)


def test_a_method_that_ends_the_process_fails() -> None:
    found = localize(lambda _: sys.exit(5))
    assert (found.status, found.reason) == (Status.FAILED, "SystemExit: 5")


def test_input_at_fault_is_not_a_failure_of_the_query() -> None:
    def broken(_: Query) -> Estimate:
        raise InputError("a.jpg is damaged")

    with pytest.raises(InputError, match="damaged"):
        localize(broken)
