"""Compiled loops give what torch gives."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest
import torch

import baselines.align.residuals as residuals
from baselines.align.residuals import Level, LevelCost, Linearisation
from scene.geometry.camera import Camera
from scene.geometry.pose import Pose
from tests.baselines.align.world import DISTORTED, PINHOLE, World, looking_down, wrong

POINTS, CHANNELS = 300, 24


def level_cost(camera: Camera, poses: int, *, trusted: bool = True) -> tuple[LevelCost, Pose]:
    """Make a level of two queries, whose points partly leave the picture, and poses for it."""
    torch.manual_seed(0)
    truth, world = looking_down(1), World(1)
    points = torch.as_tensor(world.points(camera, truth, POINTS), dtype=torch.float32)
    maps = torch.randn(2, CHANNELS, 56, 72).contiguous(memory_format=torch.channels_last)
    level = Level(
        features=maps,
        stride=(4.5, 4.4),
        reference=torch.randn(2, POINTS, CHANNELS),
        confidence=torch.rand(2, 1, 56, 72) if trusted else None,
        reference_confidence=torch.rand(2, POINTS) if trusted else None,
    )
    usable = torch.rand(2, POINTS) > 0.1
    cost = LevelCost.of(
        level, points.expand(2, -1, -1), usable, camera.intrinsics(torch.float32), 1.0, 0.3
    )
    starts = [wrong(truth, 0.3 * number, 1.0, number) for number in range(poses)]
    pose = Pose(
        torch.stack([each.rotation for each in starts]),
        torch.stack([each.translation for each in starts]),
    )
    return cost.rows(torch.arange(poses) % 2), pose


def linearised(cost: LevelCost, pose: Pose, *, by_torch: bool) -> Linearisation:
    if by_torch:
        with torch.no_grad():
            return cost.linearise(pose)
    with torch.inference_mode():
        assert cost._can_be_compiled()
        return cost.linearise(pose)


@pytest.mark.parametrize("camera", [PINHOLE, DISTORTED])
@pytest.mark.parametrize("trusted", [True, False])
@pytest.mark.parametrize("poses", [1, 5])
def test_it_is_what_torch_computes(camera: Camera, trusted: bool, poses: int) -> None:
    cost, pose = level_cost(camera, poses, trusted=trusted)
    ours, theirs = (linearised(cost, pose, by_torch=each) for each in (False, True))
    assert 0.2 < float(theirs.seen.float().mean()) < 0.95
    seen = theirs.seen
    for each in fields(Linearisation):
        a, b = getattr(ours, each.name), getattr(theirs, each.name)
        if each.name == "cost":  # that of points out of view does not count
            a, b = a[seen], b[seen]
        a, b = a.float(), b.float()
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4 * float(b.abs().max()))


@pytest.mark.parametrize("size", [(1, 1), (3, 3), (3, 4), (4, 3), (4, 4), (5, 9)])
def test_maps_of_few_cells(size: tuple[int, int]) -> None:
    camera = Camera("PINHOLE", 20 * size[1], 20 * size[0], (60.0, 60.0, 10 * size[1], 10 * size[0]))
    torch.manual_seed(1)
    x, y = torch.rand(2, 400) - 0.5
    points = torch.stack([x * size[1], y * size[0], torch.full((400,), 3.0)], -1)[None]
    level = Level(torch.randn(1, 8, *size), 20.0, torch.randn(1, 400, 8))
    usable = torch.ones(1, 400, dtype=torch.bool)
    cost = LevelCost.of(level, points, usable, camera.intrinsics(torch.float32), 1.0, 0.3)
    pose = Pose(torch.eye(3)[None], torch.zeros(1, 3))
    ours, theirs = (linearised(cost, pose, by_torch=each) for each in (False, True))
    assert torch.equal(ours.seen, theirs.seen)
    if min(size) > 3:
        assert ours.seen.any()
    most = float(theirs.pull.abs().max())
    torch.testing.assert_close(ours.pull, theirs.pull, rtol=1e-4, atol=1e-4 * most)


def test_what_is_not_finite_stays_so() -> None:
    cost, pose = level_cost(PINHOLE, 1)
    broken = cost.table.cells.clone()
    broken[:, 3] = torch.nan
    cost = replace(cost, table=replace(cost.table, cells=broken))
    around = linearised(cost, pose, by_torch=False)
    assert not around.hessian.isfinite().all() and not around.gradient.isfinite().all()


def test_gradients_and_double_precision_are_left_to_torch() -> None:
    cost, _ = level_cost(PINHOLE, 1)
    assert not cost._can_be_compiled()
    with torch.inference_mode():
        exact = replace(cost, points=cost.points.double())
        assert cost._can_be_compiled() and not exact._can_be_compiled()


def test_without_numba_torch_computes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    cost, pose = level_cost(PINHOLE, 1)
    monkeypatch.setattr(residuals, "has_compiler", lambda: False)
    with torch.inference_mode():
        assert not cost._can_be_compiled()
        around = cost.linearise(pose)
    torch.testing.assert_close(around.pull, linearised(cost, pose, by_torch=True).pull)
