from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from objconnect.learning.damping import damping_factors
from objconnect.localization.align.aligner import Alignment, align
from objconnect.localization.align.options import Options
from objconnect.localization.align.problem import Problem
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.projection import Intrinsics
from tests.objconnect.localization.align.problems import (
    DAMPING,
    PLAIN,
    Small,
    batch,
    small,
    stack_problems,
)
from tests.objconnect.localization.align.world import DISTORTED, PINHOLE, World, looking_down, wrong

SEEDS = range(4)


def one(pose: Pose) -> Pose:
    return stack_problems([pose])


def test_finds_the_pose_from_3_m_and_5_degrees() -> None:
    problems = [small(seed) for seed in SEEDS]
    all_at_once = batch(problems)
    starts = stack_problems(
        [wrong(p.truth, 3, 5, seed) for seed, p in zip(SEEDS, problems, strict=True)]
    )
    for options in (Options(), replace(PLAIN, iterations=15)):
        found = all_at_once.align(starts, options)
        assert not found.has_failed.any()
        metres, degrees = found.pose.error_to(all_at_once.truth)
        assert (metres < 0.15).all() and (degrees < 0.1).all()
    assert (all_at_once.align(starts).iterations < 25).all()  # where plain steps take 45


RATIONAL = Camera("FULL_OPENCV", 320, 256, (*DISTORTED.params, 0.05, 0.3, -0.1, 0.04))


@pytest.mark.parametrize("camera", [DISTORTED, RATIONAL], ids=lambda c: c.model)
def test_lens_with_distortion(camera: Camera) -> None:
    world, truth = World(5, strides=(16, 4, 2)), looking_down(5)
    points = world.points(camera, truth, 200)
    levels = world.levels(camera, truth, points, confident=True)
    at = torch.as_tensor(points)[None]
    start = one(wrong(truth, 3, 5, 0))
    found = align(Problem(levels, at, camera.intrinsics(), start, DAMPING, Options()))
    assert not found.has_failed.any()
    assert found.pose.error_to(truth)[0] < 0.1
    without = align(Problem(levels, at, PINHOLE.intrinsics(), start, DAMPING, Options()))
    assert without.pose.error_to(truth)[0] > 0.3


@pytest.mark.parametrize("options", [Options(), PLAIN])
def test_elements_of_a_batch_do_not_know_of_each_other(options: Options) -> None:
    problems = [small(seed) for seed in SEEDS]
    starts = [wrong(p.truth, 3, 5, seed) for seed, p in zip(SEEDS, problems, strict=True)]
    lost = wrong(problems[1].truth, 1000, 5, 0)
    starts[1] = lost
    together = batch(problems).align(stack_problems(starts), options)
    assert together.has_failed.tolist() == [False, True, False, False]
    for k in (0, 2, 3):
        alone = problems[k].align(one(starts[k]), options)
        assert torch.allclose(alone.pose.matrix()[0], together.pose.matrix()[k], atol=1e-4)
        assert alone.iterations[0] == together.iterations[k]


def test_starts_of_one_query_share_its_features() -> None:
    problems = [small(0), small(1)]
    starts = [[wrong(p.truth, 3, 5, k) for k in range(3)] for p in problems]
    both = batch(problems).align(
        Pose(
            torch.stack([stack_problems(each).rotation for each in starts]),
            torch.stack([stack_problems(each).translation for each in starts]),
        )
    )
    assert both.pose.translation.shape == (2, 3, 3)
    assert both.covariance.shape == (2, 3, 6, 6)
    for query, problem in enumerate(problems):
        for k in range(3):
            alone = problem.align(one(starts[query][k]))
            assert torch.allclose(alone.pose.matrix()[0], both.pose.matrix()[query, k], atol=1e-4)


def test_cameras_of_their_own() -> None:
    """Each query of a batch may have its camera, in one tensor."""
    problems, cameras = [small(0), small(0)], [PINHOLE, PINHOLE.resize(640, 512)]
    both = batch(problems)
    intrinsics = [camera.intrinsics() for camera in cameras]
    stack = Intrinsics.stack(intrinsics)
    start = wrong(problems[0].truth, 1, 1, 0)
    found = align(
        Problem(both.levels, both.points, stack, stack_problems([start] * 2), DAMPING, Options())
    )
    assert found.pose.error_to(both.truth)[0][0] < 0.15
    assert found.has_failed[1] or found.pose.error_to(both.truth)[0][1] > 5


def test_coordinates_far_from_the_origin_cost_no_precision() -> None:
    near = small(0)
    far = torch.tensor([4.5e5, 5.4e6, 300.0], dtype=torch.float64)
    start = wrong(near.truth, 3, 5, 0)
    moved_start = Pose(start.rotation, start.translation - start.rotation @ far)
    there = Small(near.truth, near.points + far, near.levels)
    here, away = near.align(one(start)), there.align(one(moved_start))
    torch.testing.assert_close(away.pose.centre() - far, here.pose.centre(), atol=1e-4, rtol=0)


def test_half_precision_maps_give_nearly_the_same_pose() -> None:
    exact = small(0)
    half = [replace(level, features=level.features.bfloat16()) for level in exact.levels]
    start = one(wrong(exact.truth, 3, 5, 0))
    a, b = exact.align(start), Small(exact.truth, exact.points, half).align(start)
    assert a.pose.error_to(b.pose)[0] < 0.02


def never_nan(found: Alignment) -> None:
    assert found.pose.matrix().isfinite().all()
    for tensor in (found.covariance, found.cost):
        assert not tensor.isnan().any()


@pytest.mark.parametrize("adaptive_damping", [True, False])
def test_what_cannot_be_aligned_says_why(adaptive_damping: bool) -> None:
    options = Options(adaptive_damping=adaptive_damping)
    problem = small(0)
    start = one(problem.truth)

    def with_features(value: float) -> Small:
        levels = [
            replace(lv, features=torch.full_like(lv.features, value)) for lv in problem.levels
        ]
        return replace(problem, levels=levels)

    nan = torch.nan
    astray = one(wrong(problem.truth, 1000, 0, 0))
    turned = torch.diag(torch.tensor([1.0, -1, -1], dtype=torch.float64))
    behind = Pose(turned, torch.zeros(3, dtype=torch.float64)) @ start
    cases = [
        (replace(problem, points=problem.points * nan), start, "too few points"),
        (with_features(nan), start, "features or confidences are not finite"),
        (problem, Pose(start.rotation, start.translation * nan), "starting pose is not finite"),
        (problem, astray, "too few points"),
        (problem, behind, "too few points"),
    ]
    for case, begin, why in cases:
        found = case.align(begin, options)
        assert found.has_failed.all() and why in found.reason(0)
        assert (
            torch.isinf(found.cost).all() and torch.isinf(found.covariance.diagonal(0, 1, 2)).all()
        )
        never_nan(found)


def test_points_too_few_and_features_that_say_nothing() -> None:
    problem = small(0)
    start = one(problem.truth)
    for count in (0, 1, 9):
        mask = torch.arange(200)[None] < count
        found = align(
            Problem(
                problem.levels,
                problem.points,
                PINHOLE.intrinsics(),
                start,
                DAMPING,
                Options(),
                mask,
            )
        )
        seen = int(found.points_in_view)
        assert found.reason(0) == f"too few points of the map are in view ({seen})"
        assert seen <= count
        never_nan(found)
    assert seen > 0 and found.pose.error_to(start)[0] < 1e-9
    empty = replace(
        problem,
        points=problem.points[:, :0],
        levels=[replace(lv, reference=lv.reference[:, :0]) for lv in problem.levels],
    )
    assert "(0)" in empty.align(start).reason(0)
    flat = [replace(lv, features=torch.ones_like(lv.features)) for lv in problem.levels]
    found = replace(problem, levels=flat).align(start)  # no slope anywhere: nothing moves
    assert not found.has_failed and found.pose.error_to(start)[0] < 1e-9
    assert torch.isinf(found.covariance.diagonal(0, 1, 2)).all()
    never_nan(found)


def test_gradients_reach_features_confidence_and_damping() -> None:
    """Derivatives of the last pose through all steps of a level, against finite differences."""
    problem = small(1)
    level = problem.levels[1]
    inputs = [
        level.features.double(),
        level.reference.double(),
        torch.full((1, 1, *level.features.shape[-2:]), 0.5, dtype=torch.float64),
        torch.zeros(6, dtype=torch.float64),
    ]
    start = one(wrong(problem.truth, 0.5, 0.5, 0))

    def centre(*values: torch.Tensor) -> torch.Tensor:
        features, reference, confidence, theta = values
        levels = [replace(level, features=features, reference=reference, confidence=confidence)]
        found = align(
            Problem(
                levels,
                problem.points,
                PINHOLE.intrinsics(),
                start,
                [damping_factors(theta)],
                replace(PLAIN, iterations=3),
            )
        )
        return found.pose.centre().sum()

    leaves = [value.clone().requires_grad_() for value in inputs]
    centre(*leaves).backward()
    generator = torch.Generator().manual_seed(0)
    for k, leaf in enumerate(leaves):
        direction = torch.randn(leaf.shape, generator=generator, dtype=torch.float64)
        ends = [
            centre(*(v + sign * 1e-6 * direction if j == k else v for j, v in enumerate(inputs)))
            for sign in (1, -1)
        ]
        slope = (ends[0] - ends[1]) / 2e-6
        assert slope.abs() > 0
        torch.testing.assert_close((leaf.grad * direction).sum(), slope, rtol=1e-3, atol=1e-6)


def test_gradients_stop_between_levels() -> None:
    problem = small(1)
    maps = [level.features.clone().requires_grad_() for level in problem.levels]
    levels = [replace(lv, features=m) for lv, m in zip(problem.levels, maps, strict=True)]
    found = replace(problem, levels=levels).align(one(wrong(problem.truth, 1, 1, 0)), PLAIN)
    found.level_poses[-1].translation.sum().backward()
    assert maps[0].grad is None and maps[1].grad is None
    assert maps[2].grad is not None and maps[2].grad.abs().sum() > 0
