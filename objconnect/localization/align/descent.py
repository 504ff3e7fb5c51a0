"""Damped Gauss-Newton on one level, for a batch from which converged elements are removed."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from objconnect.localization.align.damping import (
    CHANGE,
    LEAST_FACTOR,
    MOST_FACTOR,
    apply_step,
    solve_step,
)
from objconnect.localization.align.linearise import can_be_compiled, linearise
from objconnect.localization.align.options import Options
from objconnect.localization.align.residuals import LevelCost, Linearisation
from objconnect.localization.align.state import State
from objconnect.localization.align.trees import choose, rows, tree_map
from objconnect.scene.geometry.pose import Pose


def descend(
    cost: LevelCost,
    pose: Pose,
    alive: Tensor,
    damping: Tensor,
    options: Options,
) -> State:
    """Minimise the cost of one level.

    Args:
        cost: cost of the level for M poses.
        pose: (M) initial poses.
        alive: (M,) whether an element is minimised.
        damping: (6,) factors of the Hessian's diagonal.
        options: options of the minimisation.
    """
    if options.careful and can_be_compiled(cost):
        from objconnect.localization.align.compiled_loops import descend_compiled

        return descend_compiled(cost, pose, alive, damping, options)
    around = linearise(cost, pose)
    none = torch.zeros(len(alive), dtype=torch.long, device=alive.device)
    state = State(pose, around, none, torch.ones_like(none, dtype=torch.float64)[:, None])
    number = torch.arange(len(alive), device=alive.device)
    finished: list[tuple[Tensor, State]] = []
    moving = alive
    for _ in range(options.iterations):
        moving = moving & can_step(state.around, options.min_points)
        if not bool(moving.all()):
            finished.append((number[~moving], rows(state, ~moving)))
            number, state, cost = number[moving], rows(state, moving), cost.rows(moving)
        if not len(number):
            break
        step = solve_step(state.around.gradient, state.around.hessian, damping * state.damping)
        trial_pose = apply_step(state.pose, step)
        state = replace(state, iterations=state.iterations + 1)
        trial = replace(state, pose=trial_pose, around=linearise(cost, trial_pose))
        if options.careful:
            better = _falls(state.around, trial.around, options.min_points)
            state = choose(better, trial, state)
            factor = torch.where(better, 1 / CHANGE, CHANGE)[:, None]
            state = replace(
                state, damping=(state.damping * factor).clamp(LEAST_FACTOR, MOST_FACTOR)
            )
            moving = ~_small(step, options)
        else:
            state, moving = trial, torch.ones_like(number, dtype=torch.bool)
    finished.append((number, state))
    order = torch.cat([numbers for numbers, _ in finished]).argsort()
    states = [each for _, each in finished]
    return tree_map(lambda *parts: torch.cat(parts)[order], *states)


def can_step(around: Linearisation, min_points: int) -> Tensor:
    """Return (M,) whether enough points are in view and everything is finite."""
    return (around.seen.sum(-1) >= min_points) & is_finite(around)


def is_finite(around: Linearisation) -> Tensor:
    """Return (M,) whether gradient and Hessian are finite."""
    return around.gradient.isfinite().all(-1) & around.hessian.isfinite().flatten(1).all(-1)


def _falls(here: Linearisation, there: Linearisation, min_points: int) -> Tensor:
    """Return (M,) whether the mean cost falls, over the points in view from both poses."""
    both = here.seen & there.seen
    before, after = (replace(each, weight=each.weight * both) for each in (here, there))
    lower = after.mean_cost() < before.mean_cost()
    return lower & (both.sum(-1) >= min_points) & is_finite(there)


def _small(step: Tensor, options: Options) -> Tensor:
    """Return (M,) whether steps (M, 6) are small enough to end a level."""
    turn, shift = step[:, :3].norm(dim=-1), step[:, 3:].norm(dim=-1)
    small: Tensor = (turn.rad2deg() < options.converged_deg) & (shift < options.converged_m)
    return small
