"""What tells a right pose from a wrong one, on pictures made for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from objconnect.localization.align.options import Options
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import Level
from objconnect.localization.featuremetric.evidence import Evidence, measure_evidence
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose

SIDE, STRIDE, DEPTH, CHANNELS = 256, 4, 60.0, 16
CAMERA = Camera("PINHOLE", SIDE, SIDE, (256.0, 256.0, 128.0, 128.0))
POSE = Pose(torch.eye(3, dtype=torch.float64)[None], torch.zeros(1, 3, dtype=torch.float64))


def texture(period: int | None, seed: int = 0) -> torch.Tensor:
    """Unit features (C, h, w) of a picture, smooth over cells; repeated after ``period`` cells."""
    cells, rng = SIDE // STRIDE, np.random.default_rng(seed)
    made = torch.from_numpy(rng.normal(size=(1, CHANNELS, cells + 8, cells + 8))).float()
    smooth = torch.nn.functional.avg_pool2d(made, 5, 1)[..., :cells, :cells]
    if period is not None:
        index = torch.arange(cells) % period
        smooth = smooth[..., index, :][..., index]
    return torch.nn.functional.normalize(smooth, dim=1)[0]


def problem(picture: torch.Tensor, noise: float = 0.0, points: int = 600) -> Problem:
    """Points on a plane, with the features of a picture where the camera sees them, and noise."""
    rng = np.random.default_rng(1)
    xy = rng.uniform(40, SIDE - 40, (points, 2))
    rays = (xy - 128.0) / 256.0
    xyz = torch.from_numpy(np.c_[rays * DEPTH, np.full(points, DEPTH)])
    place = torch.from_numpy(2 * xy / SIDE - 1).float()[None, None]
    reference = torch.nn.functional.grid_sample(picture[None], place, align_corners=False)
    told = reference[0, :, 0].T + noise * torch.from_numpy(rng.normal(size=(points, CHANNELS)))
    told = torch.nn.functional.normalize(told, dim=1).float()
    level = Level(picture[None], STRIDE, told[None])
    damping = [torch.full((6,), 1e-3)] * 2
    return Problem(
        [level, level], xyz[None], CAMERA.intrinsics(), POSE, damping, Options(iterations=30)
    )


def aside(metres: float) -> Pose:
    return Pose(POSE.rotation, torch.tensor([[metres, 0, 0]], dtype=torch.float64))


def told(made: Problem, pose: Pose = POSE) -> Evidence:
    return measure_evidence(made, pose, 0.7)


def test_a_right_pose_stands_out_and_halves_agree() -> None:
    right = told(problem(texture(None), noise=0.2))
    wrong = told(problem(texture(None), noise=0.2), aside(9.0))
    assert right.peak > 10 > 5 > wrong.peak
    assert right.halves < 0.3
    assert right.curvature == 0.7


def test_a_query_that_looks_other_still_stands_out() -> None:
    """Noise as strong as the features themselves makes the fit far worse."""
    changed = told(problem(texture(None), noise=0.5))
    assert changed.peak > 10


def test_a_picture_that_repeats_itself_stands_out_less() -> None:
    assert told(problem(texture(12))).peak < 0.5 * told(problem(texture(None))).peak


def test_halves_of_another_picture_lead_apart() -> None:
    other = problem(texture(None, seed=5))
    right = problem(texture(None))
    levels = [replace(each, reference=right.levels[0].reference) for each in other.levels]
    assert told(replace(other, levels=levels)).halves > 1


@pytest.mark.parametrize("metres", [70.0, 1e4])
def test_points_out_of_view_tell_nothing(metres: float) -> None:
    nothing = told(problem(texture(None), points=60), aside(metres))
    assert nothing.peak == 0.0
