"""Refinement of a pose by minimizing the epipolar errors of matches to several photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.robust import CAUCHY, SIGMA_OF_MEDIAN, SINGULAR

# Keeps denominators away from zero.
_TINY = 1e-24
# Steps (rad and m) shorter than this change nothing measurable.
_CONVERGED = 1e-7
# Smallest noise of matches (px), for exact ones.
_LEAST_SIGMA = 1e-3
# Largest number of Levenberg-Marquardt steps; a pose that still moves then is unconstrained.
_MOST_STEPS: Final = 30


@dataclass(frozen=True)
class Matches:
    """Matches between a query and one photograph of known pose.

    Attributes:
        reference: ``cam_from_world`` of the photograph.
        query_rays: rays (K, 3) with z = 1, in the query's frame.
        reference_rays: rays (K, 3) with z = 1, in the photograph's frame.
    """

    reference: Pose
    query_rays: Tensor
    reference_rays: Tensor

    def residuals(self, pose: Pose, focal: float) -> tuple[Tensor, Tensor]:
        """Return Sampson errors (K,) in pixels and their derivatives (K, 6) by the left tangent.

        Args:
            pose: ``cam_from_world`` of the query.
            focal: focal length of the query, pixels.
        """
        cross = torch.linalg.cross
        relative = pose @ self.reference.inverse()
        query = self.query_rays
        seen = self.reference_rays @ relative.rotation.T
        baseline = relative.translation.expand_as(seen)
        # Epipolar lines in the query, E x_r, and in the photograph, E^T x_q, and their components
        # in the image plane, both in the query's frame.
        line = cross(baseline, seen)
        other = cross(query, baseline) @ relative.rotation
        plane = torch.tensor([1.0, 1.0, 0.0], dtype=line.dtype)
        here, there = line * plane, (other * plane) @ relative.rotation.T
        squared = (here.square().sum(1) + there.square().sum(1)).clamp_min(_TINY)[:, None]
        value = (query * line).sum(1, keepdim=True)
        d_value = torch.cat([cross(line, query), cross(seen, query)], 1)
        d_rotation = cross(line, here) + cross(query, cross(there, baseline))
        d_translation = cross(seen, here) + cross(there, query)
        half_d_squared = torch.cat([d_rotation, d_translation], 1)
        jacobian = (d_value - value / squared * half_d_squared) / squared.sqrt()
        return focal * (value / squared.sqrt())[:, 0], focal * jacobian


@dataclass(frozen=True)
class Refined:
    """The result of ``refine``.

    Attributes:
        pose: ``cam_from_world`` of the query.
        covariance: covariance (6, 6) of the left tangent (rotation rad, translation m) from the
            noise of the matches, with exact poses of the photographs; None if singular.
        iterations: number of steps tried.
    """

    pose: Pose
    covariance: NDArray[np.float64] | None
    iterations: int


def refine(start: Pose, photographs: Sequence[Matches], focal: float) -> Refined:
    """Minimize the Sampson errors over all photographs by Levenberg-Marquardt with a Cauchy loss.

    Args:
        start: initial ``cam_from_world`` of the query, float64.
        photographs: matches to each photograph.
        focal: focal length of the query, pixels.
    """
    pose, damping, iterations = start, 1e-3, 0
    error, jacobian = _stack(pose, photographs, focal)
    while iterations < _MOST_STEPS:
        iterations += 1
        scale = CAUCHY * _sigma(error)
        weighted = jacobian / (1 + (error / scale) ** 2)[:, None]
        information = weighted.T @ jacobian
        damped = information + damping * torch.diag(information.diagonal() + _TINY)
        step = torch.linalg.solve(damped, -weighted.T @ error)
        moved = Pose.exp(step) @ pose
        error_there, jacobian_there = _stack(moved, photographs, focal)
        if _cost(error_there, scale) <= _cost(error, scale):
            pose, error, jacobian, damping = moved, error_there, jacobian_there, damping / 10
        else:
            damping *= 10
        if float(step.norm()) < _CONVERGED:
            break
    sigma = _sigma(error)
    weighted = jacobian / (1 + (error / (CAUCHY * sigma)) ** 2)[:, None]
    information = weighted.T @ jacobian
    if not float(torch.linalg.cond(information)) < SINGULAR:
        return Refined(pose, None, iterations)
    return Refined(pose, (torch.linalg.inv(information) * sigma**2).numpy(), iterations)


def _stack(pose: Pose, photographs: Sequence[Matches], focal: float) -> tuple[Tensor, Tensor]:
    """Return errors and Jacobians over all photographs."""
    errors, jacobians = zip(*(m.residuals(pose, focal) for m in photographs), strict=True)
    return torch.cat(errors), torch.cat(jacobians)


def _sigma(error: Tensor) -> float:
    """Estimate the standard deviation of residuals (px) from their median, robust to outliers."""
    return max(SIGMA_OF_MEDIAN * float(error.abs().median()), _LEAST_SIGMA)


def _cost(error: Tensor, scale: float) -> float:
    return float(torch.log1p((error / scale) ** 2).sum())
