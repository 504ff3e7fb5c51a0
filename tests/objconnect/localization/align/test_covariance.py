from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.stats import chi2
from torch import Tensor

from objconnect.localization.align.aligner import Alignment, align
from objconnect.localization.align.covariance import (
    PoseUncertainty,
    covariance,
    measure_uncertainty,
)
from objconnect.localization.align.linearise import linearise
from objconnect.localization.align.local_frame import LocalProblem
from objconnect.localization.align.options import Options
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import Linearisation
from objconnect.scene.geometry.pose import Pose
from tests.objconnect.localization.align.problems import DAMPING, small
from tests.objconnect.localization.align.world import PINHOLE, World, looking_down

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
    assert not found.has_failed.any()
    errors = (found.pose @ start.inverse()).log()
    scatter = torch.cov(errors.T).diagonal().sqrt()
    predicted = found.covariance.mean(0).diagonal().sqrt()
    ratio = predicted / scatter
    assert (ratio > 0.75).all() and (ratio < 1.33).all()
    centred = errors - errors.mean(0)
    whitened = torch.linalg.solve(found.covariance, centred[..., None])[..., 0]
    assert 4.5 < (centred * whitened).sum(-1).mean() < 8  # 6 were the covariance known


CLUTTERED = 120
# Waves of 4 to 8 cells: shorter than a patch is wide, so that patches are independent.
CLUTTER = (25.0, 5.0)


@pytest.fixture(scope="module")
def cluttered() -> tuple[Problem, Pose, Alignment, NDArray[np.float64]]:
    """Queries of one place that also show what the map does not know, each something else.

    Returns:
        The problem, the true poses, the alignment, and the share that the place has in the squared
        slopes of each picture.
    """
    truth = looking_down(3)
    world = World(3, strides=(16, 4))
    points = world.points(PINHOLE, truth, 400)
    level = world.levels(PINHOLE, truth, points)[1]
    others = [World(100 + k, CLUTTER, 2.0, world.strides) for k in range(CLUTTERED)]
    clutter = np.stack([other.picture(PINHOLE, truth, 1) for other in others])
    of_place = square_slopes(level.features[0].numpy())
    shares = np.array([of_place / (of_place + square_slopes(each)) for each in clutter])
    level = replace(
        level,
        features=level.features + torch.as_tensor(clutter),
        reference=level.reference.expand(CLUTTERED, -1, -1),
    )
    poses = Pose(truth.rotation.expand(CLUTTERED, 3, 3), truth.translation.expand(CLUTTERED, 3))
    problem = Problem(
        [level],
        torch.as_tensor(points).expand(CLUTTERED, -1, -1),
        PINHOLE.intrinsics(),
        poses,
        [torch.full((6,), 1e-4)],
        Options(iterations=60, converged_m=1e-3, converged_deg=1e-2, robust_scale=100.0),
    )
    return problem, poses, align(problem), shares


@pytest.fixture(scope="module")
def spread(cluttered: tuple[Problem, Pose, Alignment, NDArray[np.float64]]) -> PoseUncertainty:
    problem, _, found, _ = cluttered
    return measure_uncertainty(problem, found.pose)


def square_slopes(picture: NDArray[np.float32]) -> float:
    return sum(float(np.square(each).mean()) for each in np.gradient(picture, axis=(1, 2)))


def nees(errors: Tensor, covariances: Tensor) -> NDArray[np.float64]:
    whitened = torch.linalg.solve(covariances, errors[..., None])[..., 0]
    return (errors * whitened).sum(-1).numpy()


def test_covers_where_the_query_shows_what_the_map_does_not_know(
    cluttered: tuple[Problem, Pose, Alignment, NDArray[np.float64]], spread: PoseUncertainty
) -> None:
    _, truth, found, shares = cluttered
    assert not found.has_failed.any()
    errors = (found.pose @ truth.inverse()).log()
    # Mean slopes of the picture tell how much of the curvature is the place's.
    assert float(spread.curvature.mean()) == pytest.approx(shares.mean(), rel=0.4)
    values = nees(errors, spread.covariance)
    assert 4.5 < values.mean() < 8
    assert np.mean(values < chi2.ppf(0.95, 6)) > 0.8
    # Half of the covariance, and that of Gauss and Newton, are found too small.
    assert nees(errors, spread.covariance / 2).mean() > 8
    assert nees(errors, found.covariance).mean() > 30


def test_equals_that_of_gauss_and_newton_where_nothing_is_new() -> None:
    world, truth = World(3, strides=(16, 4)), looking_down(3)
    points = world.points(PINHOLE, truth, POINTS)
    level = world.levels(PINHOLE, truth, points, noise=0.02)[1]
    start = Pose(truth.rotation[None], truth.translation[None])
    problem = Problem(
        [level],
        torch.as_tensor(points)[None],
        PINHOLE.intrinsics(),
        start,
        [torch.full((6,), 1e-4)],
        Options(iterations=30, converged_m=1e-3, converged_deg=1e-2),
    )
    found = align(problem)
    around = measure_uncertainty(problem, found.pose)
    assert 0.85 < float(around.curvature) <= 1
    ratio = around.covariance.diagonal(dim1=-2, dim2=-1) / found.covariance.diagonal(
        dim1=-2, dim2=-1
    )
    assert (ratio > 0.95).all() and (ratio < 1.5).all()


def linearise_plainly(problem: Problem, options: Options) -> Linearisation:
    local = LocalProblem.of(problem)
    return linearise(local.cost(problem.levels[-1], options), local.start)


def test_shrunk_covariances_lie_between_the_sandwich_and_independent_residuals(
    cluttered: tuple[Problem, Pose, Alignment, NDArray[np.float64]],
) -> None:
    problem, _, found, _ = cluttered
    around = linearise_plainly(problem.starting_at(found.pose), problem.options)
    by = {share: covariance(around, shrinkage=share) for share in (0.0, 0.25, 1.0)}
    torch.testing.assert_close(by[0.25], 0.75 * by[0.0] + 0.25 * by[1.0])
    # Independent residuals give a multiple of the inverse of the second derivatives.
    hessian = around.hessian.double()
    level = {share: (by[share] @ hessian).diagonal(dim1=-2, dim2=-1).mean(-1) for share in by}
    torch.testing.assert_close(level[0.0], level[1.0], rtol=1e-4, atol=0)
    lower = torch.linalg.cholesky(hessian)
    white = lower.transpose(-1, -2) @ by[1.0] @ lower / level[1.0][:, None, None]
    torch.testing.assert_close(white, torch.eye(6).double().expand_as(white), rtol=0, atol=1e-4)


def test_level_is_the_mean_of_the_sandwich_and_known_from_the_patches_that_pull(
    cluttered: tuple[Problem, Pose, Alignment, NDArray[np.float64]], spread: PoseUncertainty
) -> None:
    problem, _, found, _ = cluttered
    around = linearise_plainly(problem.starting_at(found.pose), problem.options)
    sandwich = covariance(around) @ around.hessian.double()
    torch.testing.assert_close(
        spread.scatter_level, sandwich.diagonal(dim1=-2, dim2=-1).mean(-1), rtol=1e-4, atol=0
    )
    assert (spread.effective_patches > 1).all()
    assert (spread.effective_patches < spread.patches).all()
    # Another scale of the features is one of the level alone.
    levels = [
        replace(each, features=3 * each.features, reference=3 * each.reference)
        for each in problem.levels
    ]
    scale = 3 * problem.options.robust_scale
    options = replace(problem.options, robust_scale=scale)
    scaled = measure_uncertainty(replace(problem, levels=levels, options=options), found.pose)
    torch.testing.assert_close(scaled.scatter_level, 9 * spread.scatter_level, rtol=1e-2, atol=0)
    torch.testing.assert_close(
        scaled.effective_patches, spread.effective_patches, rtol=1e-2, atol=0
    )


def test_where_the_grid_of_patches_begins_does_not_matter(
    cluttered: tuple[Problem, Pose, Alignment, NDArray[np.float64]],
) -> None:
    problem, _, found, _ = cluttered
    around = linearise_plainly(problem.starting_at(found.pose), Options())
    here = covariance(around, 10.0)
    moved = covariance(replace(around, cells=around.cells + torch.tensor([5.0, 15.0])), 10.0)
    torch.testing.assert_close(moved, here)
    other = covariance(replace(around, cells=around.cells + torch.tensor([2.0, 3.0])), 10.0)
    assert not torch.allclose(other, here, rtol=1e-3)


def test_nothing_is_known_where_points_are_too_few() -> None:
    world, truth = World(3, strides=(16, 4)), looking_down(3)
    points = world.points(PINHOLE, truth, 2)
    level = world.levels(PINHOLE, truth, points)[1]
    start = Pose(truth.rotation[None], truth.translation[None])
    cameras = PINHOLE.intrinsics()
    damping = [torch.full((6,), 1e-4)]
    problem = Problem([level], torch.as_tensor(points)[None], cameras, start, damping, Options())
    around = measure_uncertainty(problem, start)
    assert around.covariance.diagonal(dim1=-2, dim2=-1).isinf().all()
    assert float(around.curvature) == 0
    assert float(around.scatter_level) == float(around.effective_patches) == 0


@pytest.mark.parametrize("degrees", [0, 40])
def test_view_cosine_tells_from_what_other_direction_points_were_seen(degrees: float) -> None:
    made = small()
    pose = Pose(made.truth.rotation[None], made.truth.translation[None])
    problem = Problem(made.levels, made.points, PINHOLE.intrinsics(), pose, DAMPING, Options())
    assert float(measure_uncertainty(problem, pose).view_cosine) == 1  # not known
    centre = pose.centre()[:, None]
    turn = torch.as_tensor(cv2.Rodrigues(np.array([np.radians(degrees), 0, 0]))[0])
    # Twice as far away: only the direction counts.
    seen_from = made.points + 2 * (centre - made.points) @ turn.T
    # Points out of view do not count.
    points = torch.cat([made.points, centre + torch.tensor([0.0, 0.0, 50.0])], 1)
    seen_from = torch.cat([seen_from, points[:, -1:] + 1.0], 1)
    levels = [
        replace(level, reference=torch.cat([level.reference, level.reference[:, :1]], 1))
        for level in made.levels
    ]
    seen = replace(problem, levels=levels, points=points, seen_from=seen_from)
    cosine = float(measure_uncertainty(seen, pose).view_cosine)
    # The turn is about the x axis: a direction along it stays.
    ray = torch.nn.functional.normalize(made.points - centre, dim=-1)
    turned = ray[..., 1:].square().sum(-1)
    expected = 1 - turned * (1 - np.cos(np.radians(degrees)))
    assert cosine == pytest.approx(float(expected.mean()), abs=1e-6)


def test_informative_cost_is_that_of_the_points_that_tell_the_pose() -> None:
    made = small()
    pose = Pose(made.truth.rotation[None], made.truth.translation[None])
    levels = [replace(each, reference=each.reference + 0.03) for each in made.levels]
    levels[-1].reference[:, ::3] += 0.1  # these fit worse than others
    for trust in (None, torch.rand(made.points.shape[:2]) + 0.1):
        levels[-1] = replace(levels[-1], reference_confidence=trust)
        problem = Problem(levels, made.points, PINHOLE.intrinsics(), pose, DAMPING, Options())
        cost = LocalProblem.of(problem).cost(levels[-1], Options())
        around = cost.linearise(LocalProblem.of(problem).start)
        parts = []
        for point in range(made.points.shape[1]):  # the part of the Hessian that is its own
            only = torch.zeros_like(cost.mask)
            only[:, point] = True
            own = (
                replace(cost, mask=cost.mask & only)
                .linearise(LocalProblem.of(problem).start)
                .hessian
            )
            parts.append(torch.linalg.solve(around.hessian, own).diagonal(dim1=-2, dim2=-1).sum(-1))
        shares = torch.stack(parts, -1) / 6
        assert float(shares.sum()) == pytest.approx(1, abs=1e-4)
        expected = (shares * around.cost).sum() / around.mean_cost()
        assert abs(float(expected) - 1) > 0.01
        assert float(measure_uncertainty(problem, pose).informative_cost_ratio) == pytest.approx(
            float(expected), 1e-4
        )


def test_first_points_keep_what_they_were_seen_from() -> None:
    made = small()
    pose = Pose(made.truth.rotation[None], made.truth.translation[None])
    problem = Problem(made.levels, made.points, PINHOLE.intrinsics(), pose, DAMPING, Options())
    seen_from = torch.rand(made.points.shape, dtype=torch.float64)
    fewer = replace(problem, seen_from=seen_from).first_points(20)
    assert fewer.seen_from is not None
    assert torch.equal(fewer.seen_from, seen_from[:, :20])
    assert problem.first_points(20).seen_from is None
