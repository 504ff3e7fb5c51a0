"""What two poses see on level ground."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from experiments.causes import find_seen_ground
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose, so3_exp

CAMERA = Camera("PINHOLE", 400, 400, (400.0, 400.0, 200.0, 200.0))
HEIGHT, GROUND = 50.0, 3.0


def look_down(east: float, tilt_deg: float) -> Pose:
    """A camera at (east, 0) above the ground, tilted to the east."""
    down = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    turn = so3_exp(torch.tensor([0.0, -math.radians(tilt_deg), 0.0], dtype=torch.float64))
    rotation = turn @ down
    centre = torch.tensor([east, 0.0, GROUND + HEIGHT], dtype=torch.float64)
    return Pose(rotation, -rotation @ centre)


def test_tilt_compensates_position_on_the_ground() -> None:
    straight = find_seen_ground(look_down(0, 0), CAMERA, GROUND)
    assert straight[0] == pytest.approx(np.zeros(2), abs=1e-9)
    assert np.abs(straight[1:]) == pytest.approx(np.full((4, 2), HEIGHT / 4))
    aside = HEIGHT * math.tan(math.radians(2))
    seen = [find_seen_ground(look_down(-aside, tilt), CAMERA, GROUND)[0, 0] for tilt in (0, 2)]
    assert seen == pytest.approx([-aside, 0])
