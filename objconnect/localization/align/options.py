"""Options of the alignment and of the search around a prior."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final


@dataclass(frozen=True)
class Options:
    """Options of the minimisation of a level.

    Attributes:
        iterations: steps per level; the maximum if ``careful``.
        careful: whether a step is accepted only if the cost falls (else a shorter one is tried) and
            a level ends when steps become small. If False, every step is taken, and the pose is
            differentiable in features, confidences and damping, for training.
        border_cells: cells at the edge of a feature map in which points do not count; at least 1.
        robust_scale: norm of a residual above which it loses weight.
        min_points: minimum number of points in view; with fewer the alignment fails.
        converged_m: a level ends at a step below this length (m) and below ``converged_deg``.
        converged_deg: angle of that step, degrees.
    """

    iterations: int = 15
    careful: bool = True
    border_cells: float = 1.0
    robust_scale: float = 0.1
    min_points: int = 10
    converged_m: float = 5e-3
    converged_deg: float = 5e-2

    def rougher(self, factor: float) -> Options:
        """Return options that end a level at steps longer by a factor."""
        metres, degrees = factor * self.converged_m, factor * self.converged_deg
        return replace(self, converged_m=metres, converged_deg=degrees)


@dataclass(frozen=True)
class Width:
    """Numbers of starts and points of the search around an uncertain prior.

    Attributes:
        refined: starts refined on the coarsest level, beside the prior itself.
        coarse_points: points on the coarsest level, spread over the picture.
        first_refined: starts that are refined first, with the prior; if two of them agree on the
            best pose, the others are not refined.
        finalists: poses that continue from the coarsest level to the finer ones.
        compared_points: points on the other levels, spread over the picture; the best pose is then
            aligned to all points.
    """

    refined: int = 8
    coarse_points: int = 256
    first_refined: int = 7
    finalists: int = 2
    compared_points: int = 512

    def times(self, factor: int) -> Width:
        """Return the width with ``factor`` times the starts, all refined at once, and points."""
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
