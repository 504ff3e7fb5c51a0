"""Down one level: damped Gauss-Newton over a batch that shrinks as its elements arrive."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import torch
from torch import Tensor

from baselines.align.damping import damped_step, moved
from baselines.align.residuals import Linearisation, Problem
from baselines.align.trees import choose, rows, tree_map
from scene.geometry.pose import Pose

# A rejected step multiplies the damping by this; one taken divides it.
_CAUTION: Final = 10.0
_LEAST_CAUTION: Final = 1e-3
_MOST_CAUTION: Final = 1e8


@dataclass(frozen=True)
class Options:
    """How to go down.

    Attributes:
        iterations: steps per level; at most, and tried ones count, where ``careful``.
        careful: take a step only if the cost falls, else try a shorter one, and stop where steps
            have become small. Without it all steps are taken and the pose is differentiable by
            features, confidences and damping: for training.
        border: cells at the edge of a map in which points do not count; at least 1.
        scale: of the robust cost: residuals of larger norm lose weight.
        least_points: with fewer in view, alignment has failed.
        small_metres: a step below this and
        small_degrees: below this is the last of its level.
    """

    iterations: int = 15
    careful: bool = True
    border: float = 1.0
    scale: float = 0.1
    least_points: int = 10
    small_metres: float = 5e-3
    small_degrees: float = 5e-2


@dataclass(frozen=True)
class Place:
    """Where M elements stand.

    Attributes:
        pose: ``cam_from_world``.
        around: the cost there.
        iterations: (M,) steps tried.
        caution: (M, 1) factor on the damping.
    """

    pose: Pose
    around: Linearisation
    iterations: Tensor
    caution: Tensor


def descend(
    problem: Problem,
    pose: Pose,
    alive: Tensor,
    damping: Tensor,
    options: Options,
) -> Place:
    """Minimise the cost of one level.

    Args:
        problem: the level.
        pose: (M) where to begin.
        alive: (M,) those to move at all.
        damping: (6,) factors of the Hessian's diagonal.
        options: how.
    """
    around = problem.linearise(pose)
    still = torch.zeros(len(alive), dtype=torch.long, device=alive.device)
    place = Place(pose, around, still, torch.ones_like(still, dtype=torch.float64)[:, None])
    number = torch.arange(len(alive), device=alive.device)
    arrived: list[tuple[Tensor, Place]] = []
    going = alive
    for _ in range(options.iterations):
        going = going & healthy(place.around, options.least_points)
        if not bool(going.all()):
            arrived.append((number[~going], rows(place, ~going)))
            number, place, problem = number[going], rows(place, going), problem.rows(going)
        if not len(number):
            break
        step = damped_step(place.around.gradient, place.around.hessian, damping * place.caution)
        there = moved(place.pose, step)
        place = replace(place, iterations=place.iterations + 1)
        trial = replace(place, pose=there, around=problem.linearise(there))
        if options.careful:
            better = _falls(place.around, trial.around, options.least_points)
            place = choose(better, trial, place)
            factor = torch.where(better, 1 / _CAUTION, _CAUTION)[:, None]
            caution = (place.caution * factor).clamp(_LEAST_CAUTION, _MOST_CAUTION)
            place = replace(place, caution=caution)
            going = ~_small(step, options)
        else:
            place, going = trial, torch.ones_like(number, dtype=torch.bool)
    arrived.append((number, place))
    order = torch.cat([numbers for numbers, _ in arrived]).argsort()
    places = [each for _, each in arrived]
    return tree_map(lambda *parts: torch.cat(parts)[order], *places)


def healthy(around: Linearisation, least_points: int) -> Tensor:
    """(M,) whether enough points are in view and everything is finite."""
    return (around.seen.sum(-1) >= least_points) & is_finite(around)


def is_finite(around: Linearisation) -> Tensor:
    """(M,) whether a step can be computed."""
    return around.gradient.isfinite().all(-1) & around.hessian.isfinite().flatten(1).all(-1)


def _falls(here: Linearisation, there: Linearisation, least_points: int) -> Tensor:
    """(M,) whether the mean cost is lower there, over the points in view from both poses."""
    both = here.seen & there.seen
    before, after = (replace(each, weight=each.weight * both) for each in (here, there))
    lower = after.mean_cost() < before.mean_cost()
    return lower & (both.sum(-1) >= least_points) & is_finite(there)


def _small(step: Tensor, options: Options) -> Tensor:
    """(M,) whether steps (M, 6) end a level."""
    turn, shift = step[:, :3].norm(dim=-1), step[:, 3:].norm(dim=-1)
    small: Tensor = (turn.rad2deg() < options.small_degrees) & (shift < options.small_metres)
    return small
