"""Damped Gauss-Newton steps on one level, for a batch from which converged poses are removed."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from objconnect.localization.align.damping import (
    DAMPING_CHANGE,
    MAX_FACTOR,
    MIN_FACTOR,
    apply_step,
    solve_step,
)
from objconnect.localization.align.linearise import can_be_compiled, linearise
from objconnect.localization.align.options import Options
from objconnect.localization.align.residuals import LevelCost, Linearisation
from objconnect.localization.align.state import State
from objconnect.localization.align.trees import choose, select, tree_map
from objconnect.scene.geometry.pose import Pose


def descend(
    cost: LevelCost,
    pose: Pose,
    active: Tensor,
    damping: Tensor,
    options: Options,
) -> State:
    """Minimise the cost of one level.

    Args:
        cost: cost of the level for M poses.
        pose: (M) initial poses.
        active: (M,) whether the cost of a pose is minimised; other poses stay as they are.
        damping: (6,) factors on the Hessian's diagonal.
        options: options of the minimisation.

    Returns:
        The final poses (M) with the cost linearised around them.
    """
    if options.adaptive_damping and can_be_compiled(cost):
        from objconnect.localization.align.compiled_loops import descend_compiled

        return descend_compiled(cost, pose, active, damping, options)
    linearisation = linearise(cost, pose)
    steps = torch.zeros(len(active), dtype=torch.long, device=active.device)
    factor = torch.ones_like(steps, dtype=torch.float64)[:, None]
    state = State(pose, linearisation, steps, factor)
    rows = torch.arange(len(active), device=active.device)
    finished: list[tuple[Tensor, State]] = []
    for _ in range(options.iterations):
        active = active & can_step(state.linearisation, options.min_points)
        if not bool(active.all()):
            finished.append((rows[~active], select(state, ~active)))
            rows, state, cost = rows[active], select(state, active), cost.select(active)
        if not len(rows):
            break
        current = state.linearisation
        step = solve_step(current.gradient, current.hessian, damping * state.damping_factor)
        trial_pose = apply_step(state.pose, step)
        state = replace(state, iterations=state.iterations + 1)
        trial = replace(state, pose=trial_pose, linearisation=linearise(cost, trial_pose))
        if options.adaptive_damping:
            better = _cost_falls(current, trial.linearisation, options.min_points)
            state = choose(better, trial, state)
            factor = torch.where(better, 1 / DAMPING_CHANGE, DAMPING_CHANGE)[:, None]
            factor = (state.damping_factor * factor).clamp(MIN_FACTOR, MAX_FACTOR)
            state = replace(state, damping_factor=factor)
            active = ~_is_small(step, options)
        else:
            state, active = trial, torch.ones_like(rows, dtype=torch.bool)
    finished.append((rows, state))
    order = torch.cat([done_rows for done_rows, _ in finished]).argsort()
    states = [each for _, each in finished]
    return tree_map(lambda *parts: torch.cat(parts)[order], *states)


def can_step(linearisation: Linearisation, min_points: int) -> Tensor:
    """Return (M,) whether enough points are in view, and gradient and Hessian are finite."""
    return (linearisation.seen.sum(-1) >= min_points) & is_finite(linearisation)


def is_finite(linearisation: Linearisation) -> Tensor:
    """Return (M,) whether gradient and Hessian are finite."""
    return linearisation.gradient.isfinite().all(-1) & linearisation.hessian.isfinite().flatten(
        1
    ).all(-1)


def _cost_falls(old: Linearisation, new: Linearisation, min_points: int) -> Tensor:
    """Return (M,) whether the mean cost falls from one pose to another.

    Only points in view from both poses are compared.
    """
    in_both = old.seen & new.seen
    before, after = (replace(each, weight=each.weight * in_both) for each in (old, new))
    lower = after.mean_cost() < before.mean_cost()
    return lower & (in_both.sum(-1) >= min_points) & is_finite(new)


def _is_small(step: Tensor, options: Options) -> Tensor:
    """Return (M,) whether steps (M, 6) are small enough to end a level."""
    angle, length = step[:, :3].norm(dim=-1), step[:, 3:].norm(dim=-1)
    small: Tensor = (angle.rad2deg() < options.converged_deg) & (length < options.converged_m)
    return small
