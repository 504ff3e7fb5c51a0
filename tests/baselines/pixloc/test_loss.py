from __future__ import annotations

import pytest
import torch

from objconnect.learning.training.pose_loss import convert_to_pixels, reprojection_error
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.projection import Intrinsics


def test_errors_are_logged_in_pixels() -> None:
    """A camera moved sideways by a metre, 10 m from points: 100 px per radian make 10 px."""
    points = torch.tensor([[[0.0, 0.0, 10.0], [3.0, -2.0, 10.0]]])
    camera = Intrinsics(
        False, torch.full((2,), 100.0), torch.zeros(2), torch.zeros(4), torch.tensor(torch.inf)
    )
    truth, moved = (Pose(torch.eye(3)[None], torch.tensor([[x, 0.0, 0.0]])) for x in (0.0, 1.0))
    valid = torch.ones(1, 2, dtype=torch.bool)
    error = reprojection_error(moved, truth, points, camera, valid)
    assert error.item() == pytest.approx(2 * (26**0.5 - 1), rel=1e-4)
    assert convert_to_pixels(error).item() == pytest.approx(10, rel=1e-4)
