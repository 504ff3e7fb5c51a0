"""Compiled loops give what torch gives."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch

import objconnect.localization.align.linearise as linearising
from objconnect.localization.align import kernels
from objconnect.localization.align.compiled_loops import _MIN_THREADED_POINTS
from objconnect.localization.align.damping import MIN_ADDED, solve_step
from objconnect.localization.align.descent import descend
from objconnect.localization.align.linearise import can_be_compiled, linearise
from objconnect.localization.align.options import Options
from objconnect.localization.align.residuals import Level, LevelCost, Linearisation
from objconnect.localization.align.state import State
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.runtime.threads import torch_threads
from tests.objconnect.localization.align.world import DISTORTED, PINHOLE, World, looking_down, wrong
from tests.programs import run_and_print

POINTS, CHANNELS = 300, 24


def level_cost(
    camera: Camera, poses: int, *, trusted: bool = True, smooth: bool = False
) -> tuple[LevelCost, Pose]:
    """Make a level of two queries, whose points partly leave the picture, and poses for it."""
    torch.manual_seed(0)
    truth, world = looking_down(1), World(1)
    points = torch.as_tensor(world.points(camera, truth, POINTS), dtype=torch.float32)
    maps = torch.randn(2, CHANNELS, 56, 72)
    if smooth:
        maps = 5 * torch.nn.functional.avg_pool2d(maps, 9, 1, 4)
    maps = maps.contiguous(memory_format=torch.channels_last)
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
    cost = cost.select(torch.arange(poses) % 2)
    if smooth:  # so that poses have somewhere to go
        there = Pose(
            *(each.expand(poses, *each.shape) for each in (truth.rotation, truth.translation))
        )
        cost = replace(cost, reference=cost.sample(there)[0] + 0.1 * cost.reference)
    return cost, pose


def linearise_plainly(cost: LevelCost, pose: Pose, *, by_torch: bool) -> Linearisation:
    if by_torch:
        with torch.no_grad():
            return linearise(cost, pose)
    with torch.inference_mode():
        assert can_be_compiled(cost)
        return linearise(cost, pose)


@pytest.mark.parametrize("poses", [1, 5, 8])
def test_threads_change_no_bit(poses: int) -> None:
    cost, start = level_cost(PINHOLE, poses, smooth=True)
    alive, damping = torch.arange(poses) != 3, torch.full((6,), 1e-3)
    found = []
    for threads in (1, 2, 3):
        with torch_threads(threads), torch.inference_mode():
            found.append(descend(cost, start, alive, damping, Options(iterations=7)))
    alone = found[0]
    assert poses * POINTS > _MIN_THREADED_POINTS or poses == 1
    assert (alone.iterations[alive] > 0).all() and (alone.iterations[~alive] == 0).all()
    for shared in found[1:]:
        assert torch.equal(shared.pose.matrix(), alone.pose.matrix())
        assert torch.equal(shared.iterations, alone.iterations)
        assert torch.equal(shared.damping_factor, alone.damping_factor)
        for each in fields(Linearisation):
            assert torch.equal(
                getattr(shared.linearisation, each.name), getattr(alone.linearisation, each.name)
            )


@pytest.mark.parametrize("camera", [PINHOLE, DISTORTED])
@pytest.mark.parametrize("trusted", [True, False])
@pytest.mark.parametrize("poses", [1, 5])
def test_it_is_what_torch_computes(camera: Camera, trusted: bool, poses: int) -> None:
    cost, pose = level_cost(camera, poses, trusted=trusted)
    ours, theirs = (linearise_plainly(cost, pose, by_torch=each) for each in (False, True))
    assert 0.2 < float(theirs.seen.float().mean()) < 0.95
    seen = theirs.seen
    for each in fields(Linearisation):
        a, b = getattr(ours, each.name), getattr(theirs, each.name)
        if each.name == "cost":  # that of points out of view does not count
            a, b = a[seen], b[seen]
        a, b = a.float(), b.float()
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4 * float(b.abs().max()))


def descend_plainly(cost: LevelCost, pose: Pose, alive: torch.Tensor, *, by_torch: bool) -> State:
    arguments = (cost, pose, alive, torch.full((6,), 0.01), Options(min_points=40))
    if by_torch:
        with torch.no_grad():
            return descend(*arguments)
    with torch.inference_mode():
        return descend(*arguments)


@pytest.mark.parametrize("camera", [PINHOLE, DISTORTED])
@pytest.mark.parametrize("trusted", [True, False])
def test_a_descent_is_that_of_torch(camera: Camera, trusted: bool) -> None:
    cost, pose = level_cost(camera, 6, trusted=trusted, smooth=True)
    alive = torch.tensor([True, True, False, True, True, True])
    away = pose.translation + torch.tensor([0, 0, 0, 0, 0, 1e4])[:, None]
    pose = Pose(pose.rotation, away)  # the last one sees nothing
    ours, theirs = (descend_plainly(cost, pose, alive, by_torch=each) for each in (False, True))
    assert theirs.iterations[[0, 1, 3, 4]].min() > 2 and theirs.damping_factor.min() < 0.1
    # Rounding may decide whether a last step, shorter than what counts, is still taken.
    same = ours.iterations == theirs.iterations
    assert same.sum() >= 5 and (ours.iterations - theirs.iterations).abs().max() <= 1
    torch.testing.assert_close(ours.damping_factor[same], theirs.damping_factor[same])
    torch.testing.assert_close(ours.pose.matrix(), theirs.pose.matrix(), rtol=1e-3, atol=1e-3)
    assert torch.equal(ours.pose.matrix()[[2, 5]], pose.matrix()[[2, 5]])
    assert not ours.linearisation.seen[5].any()
    before = linearise_plainly(cost, pose, by_torch=True).mean_cost()
    moved = ours.iterations > 0
    assert (ours.linearisation.mean_cost() < 0.9 * before)[moved].all()
    costs = (each.linearisation.mean_cost() for each in (ours, theirs))
    torch.testing.assert_close(*costs, rtol=1e-3, atol=0)


def test_a_descent_from_features_that_are_not_finite_stays() -> None:
    cost, pose = level_cost(PINHOLE, 1)
    broken = torch.full_like(cost.table.values, torch.nan)
    cost = replace(cost, table=replace(cost.table, values=broken))
    alive = torch.ones(1, dtype=torch.bool)
    ours, theirs = (descend_plainly(cost, pose, alive, by_torch=each) for each in (False, True))
    assert int(ours.iterations) == int(theirs.iterations) == 0
    assert torch.equal(ours.pose.matrix(), pose.matrix())


def test_a_step_where_the_hessian_is_not_positive() -> None:
    """It takes the diagonal alone, with no more than a floor where that is negative."""
    gradient = np.arange(1.0, 7.0)
    for diagonal in ([2.0, 1, 3, 1, 1, 2], [2.0, -1, 3, 0, 1, 2]):
        for off in (0.1, 5.0):
            hessian = np.full((6, 6), off, np.float32)
            np.fill_diagonal(hessian, diagonal)
            ours = np.empty(6)
            kernels._solve_step(gradient, hessian, np.full(6, 0.3), MIN_ADDED, ours)
            theirs = solve_step(
                torch.tensor(gradient)[None], torch.tensor(hessian)[None], torch.full((6,), 0.3)
            )
            np.testing.assert_allclose(ours, theirs[0].numpy(), rtol=1e-6)


@pytest.mark.parametrize(
    "camera",
    [
        Camera("OPENCV_FISHEYE", 320, 240, (160.0, 160.0, 160.0, 120.0, 0.02, 0.0, 0.0, 0.0)),
        Camera("FULL_OPENCV", 320, 256, (*DISTORTED.params, 0.05, 0.3, -0.1, 0.04)),
    ],
    ids=["fisheye", "rational"],
)
def test_other_lenses(camera: Camera) -> None:
    cost, pose = level_cost(camera, 3, smooth=True)
    ours, theirs = (linearise_plainly(cost, pose, by_torch=each) for each in (False, True))
    assert ours.seen.any() and torch.equal(ours.seen, theirs.seen)
    most = float(theirs.hessian.abs().max())
    torch.testing.assert_close(ours.hessian, theirs.hessian, rtol=1e-4, atol=1e-4 * most)
    alive = torch.ones(3, dtype=torch.bool)
    here, there = (descend_plainly(cost, pose, alive, by_torch=each) for each in (False, True))
    torch.testing.assert_close(here.pose.matrix(), there.pose.matrix(), rtol=1e-3, atol=1e-4)


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
    ours, theirs = (linearise_plainly(cost, pose, by_torch=each) for each in (False, True))
    assert torch.equal(ours.seen, theirs.seen)
    if min(size) > 3:
        assert ours.seen.any()
    most = float(theirs.point_gradient.abs().max())
    torch.testing.assert_close(
        ours.point_gradient, theirs.point_gradient, rtol=1e-4, atol=1e-4 * most
    )


def test_what_is_not_finite_stays_so() -> None:
    cost, pose = level_cost(PINHOLE, 1)
    broken = cost.table.values.clone()
    broken[:, 3] = torch.nan
    cost = replace(cost, table=replace(cost.table, values=broken))
    linearisation = linearise_plainly(cost, pose, by_torch=False)
    assert (
        not linearisation.hessian.isfinite().all() and not linearisation.gradient.isfinite().all()
    )


def test_gradients_and_double_precision_are_left_to_torch() -> None:
    cost, _ = level_cost(PINHOLE, 1)
    assert not can_be_compiled(cost)
    with torch.inference_mode():
        exact = replace(cost, points=cost.points.double())
        assert can_be_compiled(cost) and not can_be_compiled(exact)


def test_without_numba_torch_computes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    cost, pose = level_cost(PINHOLE, 1)
    monkeypatch.setattr(linearising, "supports_loops", lambda device: False)
    with torch.inference_mode():
        assert not can_be_compiled(cost)
        linearisation = linearise(cost, pose)
    torch.testing.assert_close(
        linearisation.point_gradient, linearise_plainly(cost, pose, by_torch=True).point_gradient
    )


FIRST = """
import hashlib
from pathlib import Path
import torch
from objconnect.localization.align import kernels
from objconnect.localization.align.compiled_loops import descend_compiled
from objconnect.localization.align.options import Options
from tests.objconnect.localization.align.test_compiled_loops import level_cost
from tests.objconnect.localization.align.world import DISTORTED

with torch.inference_mode():
    cost, pose = level_cost(DISTORTED, 4, smooth=True)
    moving, damping = torch.ones(4, dtype=torch.bool), torch.full((6,), 1e-3)
    state = descend_compiled(cost, pose, moving, damping, Options())
parts = (state.pose.rotation, state.pose.translation, state.linearisation.hessian)
print(hashlib.sha256(b"".join(part.numpy().tobytes() for part in parts)).hexdigest())
"""


@pytest.mark.thorough
def test_the_process_that_compiles_gives_the_bits_of_those_after_it(tmp_path: Path) -> None:
    first = run_and_print(FIRST, NUMBA_CACHE_DIR=str(tmp_path))
    assert list(tmp_path.rglob("kernels.descend*.nbc"))
    assert run_and_print(FIRST, NUMBA_CACHE_DIR=str(tmp_path)) == first
