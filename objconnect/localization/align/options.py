"""What callers choose for an alignment: how levels are minimised, and how wide a search is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final


@dataclass(frozen=True)
class Options:
    """How the cost of a level is minimised.

    Attributes:
        iterations: steps per level; with careful, the most steps that are tried.
        careful: a step is taken only where the cost falls, else a shorter one is tried, and the
            level ends where steps have become small. Without it every step is taken, and the pose
            is differentiable by features, confidences and damping, as training needs it.
        border_cells: cells at the edge of a feature map in which points do not count; at least 1.
        robust_scale: norm of a residual above which it loses weight.
        min_points: alignment has failed when fewer points than this are in view.
        converged_m: steps shorter than this (and ``converged_deg``) end a level, metres.
        converged_deg: steps that turn less than this (and ``converged_m``) end a level.
    """

    iterations: int = 15
    careful: bool = True
    border_cells: float = 1.0
    robust_scale: float = 0.1
    min_points: int = 10
    converged_m: float = 5e-3
    converged_deg: float = 5e-2

    def rougher(self, factor: float) -> Options:
        """Return options by which longer steps, by this factor, end a level."""
        metres, degrees = factor * self.converged_m, factor * self.converged_deg
        return replace(self, converged_m=metres, converged_deg=degrees)


@dataclass(frozen=True)
class Width:
    """How many starts around an uncertain prior are compared and refined.

    Attributes:
        refined: starts refined beside the prior itself on the coarsest level.
        coarse_points: points by which starts are compared and refined on the coarsest level, spread
            over the picture.
        first_refined: starts that are refined first, the prior among them: where another of these
            has led to the pose of the best, the others are not refined.
        finalists: poses that go on from the coarsest level to the finer ones.
        compared_points: points that the levels of a search see, spread over the picture; the best
            pose is then aligned to all.
    """

    refined: int = 8
    coarse_points: int = 256
    first_refined: int = 7
    finalists: int = 2
    compared_points: int = 512

    def times(self, factor: int) -> Width:
        """Return the width by which so many times the starts, all at once, and points are tried."""
        refined = factor * self.refined
        return Width(
            refined,
            factor * self.coarse_points,
            refined + 1,
            factor * self.finalists,
            factor * self.compared_points,
        )


WIDTH: Final = Width()
"""The width of a search from a prior."""


@dataclass(frozen=True)
class SearchRadius:
    """The extent of the search around a prior.

    Attributes:
        metres: the largest error of position to expect, in any direction.
        degrees: the largest error of attitude.
    """

    metres: float = 8.0
    degrees: float = 10.0
