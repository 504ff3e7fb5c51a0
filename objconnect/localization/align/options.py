"""Options of the aligner: how each level is minimised, and how many starts are compared."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field

from objconnect.scene.config import Config


class SolverOptions(Config):
    """Options of the minimisation of a level, part of a method's recorded configuration."""

    border_cells: float = Field(
        1.0,
        ge=0,
        description="Cells at the edge of a feature map in which points do not count; at least 1.",
    )
    robust_scale: float = Field(
        0.1, gt=0, description="Norm of a residual above which it loses weight."
    )
    min_points: int = Field(
        10, ge=1, description="Alignment has failed when fewer points than this are in view."
    )
    converged_m: float = Field(
        5e-3, gt=0, description="Steps shorter than this (and converged_deg) end a level (m)."
    )
    converged_deg: float = Field(
        5e-2, gt=0, description="Steps that turn less than this (and converged_m) end a level."
    )
    damping_change: float = Field(
        10.0,
        gt=1,
        description="A rejected step multiplies the damping by this; an accepted one divides it.",
    )
    covariance_patch_cells: float = Field(
        24.0,
        gt=0,
        description="Side of the square patches of a level (cells) whose points count as "
        "dependent in the covariance.",
    )
    covariance_shrinkage: float = Field(
        0.6,
        ge=0,
        le=1,
        description="How far the scatter of the patches' pulls is drawn to that of independent "
        "residuals in the covariance: 0 is not at all.",
    )
    curvature_sigmas: float = Field(
        3.6,
        gt=0,
        description="Standard deviations from a pose at which the curvature of its cost is "
        "measured, for the covariance.",
    )
    least_curvature: float = Field(
        0.05,
        gt=0,
        description="Least curvature that a covariance assumes in any direction, as a share of "
        "Gauss and Newton's.",
    )


class Options(SolverOptions):
    """``SolverOptions`` and what callers choose for each alignment."""

    iterations: int = Field(
        15, ge=0, description="Steps per level; with careful, the most steps that are tried."
    )
    careful: bool = Field(
        True,
        description="Take a step only where the cost falls, else try a shorter one, and stop "
        "where steps have become small. Without it every step is taken, and the pose is "
        "differentiable by features, confidences and damping, as training needs it.",
    )

    def rougher(self, factor: float) -> Options:
        """Return options by which longer steps, by this factor, end a level."""
        return self.model_copy(
            update={
                "converged_m": factor * self.converged_m,
                "converged_deg": factor * self.converged_deg,
            }
        )


class HypothesisOptions(Config):
    """Options by which starts around an uncertain prior are placed, compared and refined."""

    spacing_cells: float = Field(
        1.7, gt=0, description="Cells of the coarsest level between neighbouring picture shifts."
    )
    turn_spacing_deg: float = Field(
        6.0, gt=0, description="Degrees between neighbouring turns about the camera's axis."
    )
    max_shifts: int = Field(17, ge=1, description="Most shifts along either axis of the picture.")
    shift_margin: float = Field(
        1.2,
        gt=0,
        description="Factor on the joint shift by errors of position and attitude, which may "
        "point in different directions.",
    )
    turn_share: float = Field(
        0.6, ge=0, description="Largest turn about the camera's axis, as a share of the radius."
    )
    refined: int = Field(
        8, ge=1, description="Starts refined beside the prior itself on the coarsest level."
    )
    coarse_points: int = Field(
        256,
        ge=10,
        description="Points by which starts are compared and refined on the coarsest level, spread "
        "over the picture.",
    )
    first_refined: int = Field(
        7,
        ge=1,
        description="Starts that are refined first, the prior among them: where another of these "
        "has led to the pose of the best, the others are not refined.",
    )
    finalists: int = Field(
        2, ge=1, description="Poses that go on from the coarsest level to the finer ones."
    )
    merge_iterations: int = Field(
        4, ge=1, description="Steps after which hypotheses that have met continue as one."
    )
    rough_convergence: float = Field(
        8.0,
        gt=0,
        description="Factor on the step lengths that end a hypothesis on the coarsest level.",
    )
    same_pose_cells: float = Field(
        0.5,
        gt=0,
        description="Poses whose points lie closer than this on average (cells) count as one.",
    )
    chance_cells: int = Field(
        256, ge=1, description="Cells of the finest level that the cost by chance is taken from."
    )

    def times(self, factor: int) -> HypothesisOptions:
        """Return options by which so many times the starts, all at once, and points are tried."""
        refined = factor * self.refined
        return self.model_copy(
            update={
                "refined": refined,
                "first_refined": refined + 1,
                "finalists": factor * self.finalists,
                "coarse_points": factor * self.coarse_points,
            }
        )


@dataclass(frozen=True)
class SearchRadius:
    """The extent of the search around a prior.

    Attributes:
        metres: the largest error of position to expect, in any direction.
        degrees: the largest error of attitude.
    """

    metres: float = 8.0
    degrees: float = 10.0
