from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from baselines.align.hypotheses import _best, align_from_many, around
from baselines.align.options import HypothesisOptions, Options, SearchRadius
from baselines.align.problem import Problem
from scene.geometry.pose import Pose
from tests.baselines.align.problems import DAMPING, Small, batch, small, stacked
from tests.baselines.align.world import PINHOLE, looking_down, wrong

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
        start = stacked([wrong(truth, 10, 10, seed)])
        poses = around(start, torch.tensor([80.0]), reach, 5.9, HypothesisOptions())
        seen = PINHOLE.project(poses.transform(ground)[0])
        best.append(float((seen.xy - pixels).norm(dim=-1).mean(-1).min()))
        first = PINHOLE.project(start.transform(ground)).xy
        before.append(float((first - pixels).norm(dim=-1).mean()))
    assert max(best) < 24 < np.median(before)


def test_narrow_reach_asks_less() -> None:
    start, distance = stacked([looking_down(0)]), torch.tensor([80.0])
    sizes = [
        around(
            start, distance, SearchRadius(metres, degrees), 3.5, HypothesisOptions()
        ).translation.shape[1]
        for metres, degrees in ((1, 1), (8, 10), (30, 20))
    ]
    assert sizes == [27, 243, 17 * 17 * 5]


def test_many_starts_reach_what_one_does_not() -> None:
    """From 10 m and 10 degrees off, with features that guide no further than a cell or two."""
    problems = [small(seed, (10, 5, 4), 2) for seed in SEEDS]
    everything = batch(problems)
    starts = stacked([wrong(p.truth, 10, 10, s) for s, p in zip(SEEDS, problems, strict=True)])
    single = everything.align(starts)
    many = align_from_many(
        Problem(
            everything.levels, everything.points, PINHOLE.intrinsics(), starts, DAMPING, Options()
        ),
        SearchRadius(10, 10),
    )
    assert many.pose.translation.shape == (len(SEEDS), 3)
    assert not many.failed.any()
    assert (many.pose.error_to(everything.truth)[0] < 0.25).all()
    assert (single.pose.error_to(everything.truth)[0] < 0.25).sum() <= len(SEEDS) // 2
    torch.testing.assert_close(many.by_level[-1].matrix(), many.pose.matrix())


def test_many_points_in_place_are_worth_more_than_a_few_that_fit_perfectly() -> None:
    problem = small(0)
    twice = [wrong(problem.truth, 0.1, 0.1, seed) for seed in range(3)]
    found = problem.align(Pose(*(t[None] for t in vars(stacked(twice)).values())))
    level, scale = problem.levels[-1], Options().robust_scale
    ranked = replace(
        found,
        cost=torch.tensor([[0.0, 0.004, 0.001]]).to(found.cost),
        seen=torch.tensor([[12, 180, 200]]),
        failure=torch.tensor([[0, 0, 1]]),
    )
    assert _best(ranked, level, scale, 3, 256).seen.tolist() == [[180, 12, 200]]


def test_hypotheses_that_have_met_go_on_as_one() -> None:
    """Nine starts, four steps each at most; from there on it takes what one start does."""
    problem = small(0)
    start = stacked([wrong(problem.truth, 0.5, 0.5, 0)])
    place = problem.points, PINHOLE.intrinsics(), start
    found = align_from_many(Problem(problem.levels, *place, DAMPING, Options()), SearchRadius(1, 1))
    alone = problem.align(start)
    assert found.iterations.item() <= 9 * 4 + alone.iterations.item()


@pytest.mark.parametrize("value", [torch.nan, 1.0])
def test_hopeless_input_fails_with_a_reason(value: float) -> None:
    problem = small(0)
    start = stacked([wrong(problem.truth, 2000, 0, 0)])
    points = torch.full_like(problem.points, value)

    def found(case: Small) -> str:
        result = align_from_many(
            Problem(case.levels, case.points, PINHOLE.intrinsics(), start, DAMPING, Options()),
            SearchRadius(),
        )
        assert result.failed.all() and result.pose.matrix().isfinite().all()
        return result.reason(0)

    assert "too few points" in found(problem)
    assert "too few points" in found(replace(problem, points=points))
