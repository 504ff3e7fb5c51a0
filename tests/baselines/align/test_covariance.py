from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from baselines.align.aligner import align
from baselines.align.options import Options
from baselines.align.problem import Problem
from scene.geometry.pose import Pose
from tests.baselines.align.world import PINHOLE, World, looking_down

TRIALS = 150
POINTS = 150


@pytest.mark.parametrize("ranks", [24, 2])
def test_predicts_the_scatter_of_poses(ranks: int) -> None:
    """Noise of all channels for themselves, and noise of all channels together."""
    world, truth = World(3, strides=(16, 4)), looking_down(3)
    points = world.points(PINHOLE, truth, POINTS)
    level = world.levels(PINHOLE, truth, points)[1]
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 0.05, (TRIALS, POINTS, ranks))
    if ranks < level.reference.shape[-1]:
        noise = noise @ rng.normal(size=(ranks, level.reference.shape[-1]))
    level = replace(
        level,
        features=level.features.expand(TRIALS, -1, -1, -1),
        reference=level.reference + torch.as_tensor(noise, dtype=torch.float32),
    )
    start = Pose(truth.rotation.expand(TRIALS, 3, 3), truth.translation.expand(TRIALS, 3))
    found = align(
        Problem(
            [level],
            torch.as_tensor(points).expand(TRIALS, -1, -1),
            PINHOLE.intrinsics(),
            start,
            [torch.full((6,), 1e-4)],
            Options(iterations=30, converged_m=1e-3, converged_deg=1e-2),
        )
    )
    assert not found.failed.any()
    errors = (found.pose @ start.inverse()).log()
    scatter = torch.cov(errors.T).diagonal().sqrt()
    predicted = found.covariance.mean(0).diagonal().sqrt()
    ratio = predicted / scatter
    assert (ratio > 0.75).all() and (ratio < 1.33).all()
    centred = errors - errors.mean(0)
    whitened = torch.linalg.solve(found.covariance, centred[..., None])[..., 0]
    assert 4.5 < (centred * whitened).sum(-1).mean() < 8  # 6 were the covariance known
