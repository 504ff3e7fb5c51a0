from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from objconnect.localization.align.damping import apply_step
from objconnect.localization.align.residuals import Level, LevelCost
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from tests.objconnect.localization.align.world import DISTORTED, PINHOLE, World, looking_down, wrong


@pytest.mark.parametrize("camera", [PINHOLE, DISTORTED])
def test_gradient_and_hessian_are_those_of_autograd(camera: Camera) -> None:
    """On features that are linear in the picture, where central differences are exact."""
    torch.manual_seed(0)
    world, truth = World(1), looking_down(1)
    points = torch.as_tensor(world.points(camera, truth, 60))[None]
    stride = 4.0
    y, x = torch.meshgrid(
        torch.arange(64, dtype=torch.float64), torch.arange(80, dtype=torch.float64), indexing="ij"
    )
    mixing = torch.randn(6, 2, dtype=torch.float64) / 50
    maps = torch.einsum("cd,dhw->chw", mixing, torch.stack([x, y]))[None]
    level = Level(
        features=maps,
        stride=stride,
        reference=torch.randn(1, 60, 6, dtype=torch.float64) / 10,
        reference_confidence=torch.rand(1, 60, dtype=torch.float64),
        confidence=torch.full((1, 1, 64, 80), 0.7, dtype=torch.float64),
    )
    usable = torch.ones(1, 60, dtype=torch.bool)
    problem = LevelCost.of(level, points, usable, camera.intrinsics(), 1, 0.1)
    start = wrong(truth, 1, 2, 0)
    start = Pose(start.rotation[None], start.translation[None])
    around = problem.linearise(start)
    assert 30 < around.seen.sum() < 60  # some have left the picture
    step = torch.zeros(1, 6, dtype=torch.float64, requires_grad=True)
    there = problem.linearise(apply_step(start, step))
    (there.weight.detach() * there.cost).sum().backward()
    torch.testing.assert_close(around.gradient, step.grad / 2)

    def residuals(delta: torch.Tensor) -> torch.Tensor:
        xy = camera.project(apply_step(start, delta).transform(points)).xy
        weight = (around.weight / (1 + squared / 0.02)).sqrt()
        return ((xy / stride - 0.5) @ mixing.T - level.reference) * weight[..., None]

    squared = torch.special.expm1(around.cost / 0.02) * 0.02
    J = torch.autograd.functional.jacobian(residuals, torch.zeros(1, 6, dtype=torch.float64))
    J = J.reshape(-1, 6)
    torch.testing.assert_close(around.hessian[0], J.T @ J)


def test_confidence_scales_and_masks_remove() -> None:
    world, truth = World(2), looking_down(2)
    points = world.points(PINHOLE, truth, 50)
    level = world.levels(PINHOLE, truth, points, noise=0.1)[1]
    pose = Pose(truth.rotation[None], truth.translation[None])
    local = torch.as_tensor(points, dtype=torch.float32)[None]
    first = torch.arange(50)[None] < 25

    def linearise(level: Level, usable: torch.Tensor) -> torch.Tensor:
        problem = LevelCost.of(level, local, usable, PINHOLE.intrinsics(torch.float32), 1, 0.1)
        return problem.linearise(pose).hessian

    everything = torch.ones_like(first)
    trusted = replace(level, reference_confidence=first.float() * 2)
    torch.testing.assert_close(linearise(trusted, everything), 2 * linearise(level, first))
    half = torch.full_like(level.features[:, :1], 0.5)
    trusted = replace(level, confidence=half)
    torch.testing.assert_close(linearise(trusted, first), 0.5 * linearise(level, first))
