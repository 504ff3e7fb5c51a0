"""Options of the alignment and of the search around a prior."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final


@dataclass(frozen=True)
class Options:
    """Options of the alignment on a level.

    Attributes:
        iterations: number of steps per level; the maximum number with ``adaptive_damping``.
        adaptive_damping: whether a step is accepted only if the cost falls (else the damping is
            increased), and a level ends when steps become small. If False, every step is taken,
            and the pose is differentiable in features, confidences and damping, for training.
        border_cells: cells at the edge of a feature map in which points are ignored; at least 1.
        robust_scale: norm of a residual above which it loses weight.
        min_points: minimum number of points in view; with fewer the alignment fails.
        converged_m: metres; a level ends at a step that translates by less than this and rotates
            by less than ``converged_deg``.
        converged_deg: degrees; see ``converged_m``.
    """

    iterations: int = 15
    adaptive_damping: bool = True
    border_cells: float = 1.0
    robust_scale: float = 0.1
    min_points: int = 10
    converged_m: float = 5e-3
    converged_deg: float = 5e-2

    def loosen_convergence(self, factor: float) -> Options:
        """Return options that end a level at steps that are longer by a factor."""
        metres, degrees = factor * self.converged_m, factor * self.converged_deg
        return replace(self, converged_m=metres, converged_deg=degrees)


@dataclass(frozen=True)
class SearchWidth:
    """Numbers of hypotheses and points of the search around an uncertain prior.

    Attributes:
        refined: hypotheses that are refined on the coarsest level in addition to the prior.
        coarse_points: points on the coarsest level, spread over the picture.
        first_refined: hypotheses, the prior included, that are refined first; if two of them agree
            on the best pose, the others are not refined.
        finalists: poses that continue from the coarsest level to the finer levels.
        compared_points: points on the finer levels, spread over the picture; the best pose is then
            aligned to all points.
    """

    refined: int = 8
    coarse_points: int = 256
    first_refined: int = 7
    finalists: int = 2
    compared_points: int = 512

    def multiply(self, factor: int) -> SearchWidth:
        """Return the width with ``factor`` times the hypotheses and points.

        All hypotheses are refined at once.
        """
        refined = factor * self.refined
        return SearchWidth(
            refined,
            factor * self.coarse_points,
            refined + 1,
            factor * self.finalists,
            factor * self.compared_points,
        )


SEARCH_WIDTH: Final = SearchWidth()
"""The default width of a search."""


@dataclass(frozen=True)
class SearchRadius:
    """The extent of the search around a prior.

    Attributes:
        metres: largest error of the position to expect, in any direction.
        degrees: largest error of the attitude to expect.
    """

    metres: float = 8.0
    degrees: float = 10.0
