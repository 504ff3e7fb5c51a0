from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from objconnect.localization.align.aligner import Alignment
from objconnect.localization.align.hypotheses import (
    _MERGE_ITERATIONS,
    _keep_best,
    align_from_many,
    grid_around,
)
from objconnect.localization.align.options import Options, SearchRadius, SearchWidth
from objconnect.localization.align.problem import Problem
from objconnect.scene.geometry.pose import Pose
from tests.objconnect.localization.align.problems import (
    DAMPING,
    Small,
    batch,
    small,
    stack_problems,
)
from tests.objconnect.localization.align.world import PINHOLE, looking_down, wrong

SEEDS = range(6)


def test_grid_holds_a_pose_near_every_prior_error() -> None:
    """Of all poses within reach, some hypothesis shows the picture less than 1.5 cells off."""
    reach = SearchRadius(10, 10)
    pixels = torch.tensor([[90.0, 70.0], [230.0, 70.0], [160.0, 128.0], [160.0, 200.0]]).double()
    best, before = [], []
    for seed in range(20):
        truth = looking_down(seed)
        rays = PINHOLE.unproject(pixels)[0] @ truth.rotation
        ground = truth.centre() - rays * (truth.centre()[2] / rays[:, 2:])
        start = stack_problems([wrong(truth, 10, 10, seed)])
        poses = grid_around(start, torch.tensor([80.0]), reach, 5.9)
        seen = PINHOLE.project(poses.transform(ground)[0])
        best.append(float((seen.xy - pixels).norm(dim=-1).mean(-1).min()))
        first = PINHOLE.project(start.transform(ground)).xy
        before.append(float((first - pixels).norm(dim=-1).mean()))
    assert max(best) < 24 < np.median(before)


def test_narrow_reach_asks_less() -> None:
    start, distance = stack_problems([looking_down(0)]), torch.tensor([80.0])
    sizes = [
        grid_around(start, distance, SearchRadius(metres, degrees), 3.5).translation.shape[1]
        for metres, degrees in ((1, 1), (8, 10), (30, 20))
    ]
    assert sizes == [27, 243, 17 * 17 * 5]


def test_many_starts_reach_what_one_does_not() -> None:
    """From 10 m and 10 degrees off, with features that guide no further than a cell or two."""
    problems = [small(seed, (10, 5, 4), 2) for seed in SEEDS]
    everything = batch(problems)
    starts = stack_problems(
        [wrong(p.truth, 10, 10, s) for s, p in zip(SEEDS, problems, strict=True)]
    )
    single = everything.align(starts)
    many = align_from_many(
        Problem(
            everything.levels, everything.points, PINHOLE.intrinsics(), starts, DAMPING, Options()
        ),
        SearchRadius(10, 10),
    )
    assert many.pose.translation.shape == (len(SEEDS), 3)
    assert not many.has_failed.any()
    assert (many.pose.error_to(everything.truth)[0] < 0.25).all()
    assert (single.pose.error_to(everything.truth)[0] < 0.25).sum() <= len(SEEDS) // 2
    torch.testing.assert_close(many.level_poses[-1].matrix(), many.pose.matrix())


def test_many_points_in_place_are_worth_more_than_a_few_that_fit_perfectly() -> None:
    problem = small(0)
    twice = [wrong(problem.truth, 0.1, 0.1, seed) for seed in range(3)]
    found = problem.align(Pose(*(t[None] for t in vars(stack_problems(twice)).values())))
    level, scale = problem.levels[-1], Options().robust_scale
    ranked = replace(
        found,
        cost=torch.tensor([[0.0, 0.004, 0.001]]).to(found.cost),
        points_in_view=torch.tensor([[12, 180, 200]]),
        failure=torch.tensor([[0, 0, 1]]),
    )
    assert _keep_best(ranked, level, scale, 3).points_in_view.tolist() == [[180, 12, 200]]


def test_hypotheses_that_have_met_go_on_as_one() -> None:
    """The first starts, some steps each; from there on it takes what one start does."""
    problem = small(0)
    start = stack_problems([wrong(problem.truth, 0.5, 0.5, 0)])
    place = problem.points, PINHOLE.intrinsics(), start
    found = align_from_many(Problem(problem.levels, *place, DAMPING, Options()), SearchRadius(1, 1))
    alone = problem.align(start)
    most = SearchWidth().first_refined * _MERGE_ITERATIONS
    assert found.iterations.item() <= most + alone.iterations.item()


def many_from(problem: Small, off: float, **width: int) -> Alignment:
    """Align a problem from a prior that is off by so many metres and degrees."""
    start = stack_problems([wrong(problem.truth, off, off, 0)])
    place = problem.points, PINHOLE.intrinsics(), start
    return align_from_many(
        Problem(problem.levels, *place, DAMPING, Options()),
        SearchRadius(8, 8),
        SearchWidth(**width),
    )


def test_starts_are_not_refined_where_the_first_agree() -> None:
    problem = small(0, (10, 5, 4), 2)
    few, every = (many_from(problem, 3, first_refined=first) for first in (4, 9))
    assert few.iterations.item() < every.iterations.item() - 4
    assert float(few.pose.error_to(every.pose)[0]) < 0.01
    assert float(few.pose.error_to(problem.truth)[0]) < 0.25


def test_a_first_start_alone_agrees_with_none() -> None:
    """The others are then refined after it, and the result is that of all at once."""
    problem = small(0, (10, 5, 4), 2)
    alone, every = (many_from(problem, 8, first_refined=first) for first in (1, 9))
    assert alone.iterations.item() == every.iterations.item()
    torch.testing.assert_close(alone.pose.matrix(), every.pose.matrix())


def test_the_coarsest_level_looks_at_the_first_points_alone() -> None:
    problem = small(0, (10, 5, 4), 2)
    count = problem.points.shape[1] // 2
    half, whole = (many_from(problem, 3, coarse_points=points) for points in (count, 2 * count))
    assert not torch.equal(half.level_poses[0].matrix(), whole.level_poses[0].matrix())
    assert half.points_in_view.item() > count
    assert float(half.pose.error_to(whole.pose)[0]) < 0.01


@pytest.mark.parametrize("value", [torch.nan, 1.0])
def test_hopeless_input_fails_with_a_reason(value: float) -> None:
    problem = small(0)
    start = stack_problems([wrong(problem.truth, 2000, 0, 0)])
    points = torch.full_like(problem.points, value)

    def align_case(case: Small) -> str:
        result = align_from_many(
            Problem(case.levels, case.points, PINHOLE.intrinsics(), start, DAMPING, Options()),
            SearchRadius(),
        )
        assert result.has_failed.all() and result.pose.matrix().isfinite().all()
        return result.reason(0)

    assert "too few points" in align_case(problem)
    assert "too few points" in align_case(replace(problem, points=points))
