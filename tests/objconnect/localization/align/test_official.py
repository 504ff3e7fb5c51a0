"""Plain steps go where PixLoc's own optimizer goes (commit 65a51a7, recorded)."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from objconnect.learning.damping import Damping
from objconnect.localization.align.aligner import align
from objconnect.localization.align.options import Options
from objconnect.localization.align.problem import Problem
from objconnect.scene.geometry.pose import Pose
from tests.objconnect.localization.align.official import CASES, ITERATIONS, RECORD, case


@pytest.mark.parametrize("name", CASES)
def test_poses_are_those_of_the_official_optimizer(name: str) -> None:
    at, record = case(name), np.load(RECORD)
    damping = []
    for theta in at.thetas:
        module = Damping()
        module.theta.data = theta
        damping.append(module())
    start = Pose(at.start.rotation[None], at.start.translation[None])
    for count in ITERATIONS:
        options = Options(iterations=count, adaptive_damping=False, border_cells=4)
        found = align(
            Problem(at.levels, at.points[None], at.camera.intrinsics(), start, damping, options)
        )
        assert not found.has_failed.any()
        rotation = torch.as_tensor(record[f"{name}/{count}/R"])
        translation = torch.as_tensor(record[f"{name}/{count}/t"])
        torch.testing.assert_close(found.pose.rotation[0].float(), rotation, atol=1e-4, rtol=0)
        torch.testing.assert_close(
            found.pose.translation[0].float(), translation, atol=1e-4, rtol=0
        )
