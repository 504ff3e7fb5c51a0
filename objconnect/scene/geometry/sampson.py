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
from objconnect.scene.geometry.robust import CAUCHY_SCALE, MAX_CONDITION, SIGMA_OF_MEDIAN

# Smallest denominator.
_TINY = 1e-24
# Steps (rad and m) shorter than this change nothing measurable.
_MIN_STEP = 1e-7
# Smallest standard deviation of matches (px). It would be zero for simulated, exact matches.
_LEAST_SIGMA = 1e-3
# Largest number of Levenberg-Marquardt steps; a pose that still moves then is unconstrained.
_MAX_STEPS: Final = 30


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
        reference_in_query = self.reference_rays @ relative.rotation.T
        baseline = relative.translation.expand_as(reference_in_query)
        # Epipolar lines in the query, E x_r, and in the photograph, E^T x_q, and their components
        # in the image plane, both in the query's frame.
        line = cross(baseline, reference_in_query)
        reference_line = cross(query, baseline) @ relative.rotation
        plane = torch.tensor([1.0, 1.0, 0.0], dtype=line.dtype)
        line_xy, reference_xy = line * plane, (reference_line * plane) @ relative.rotation.T
        squared = (line_xy.square().sum(1) + reference_xy.square().sum(1)).clamp_min(_TINY)[:, None]
        value = (query * line).sum(1, keepdim=True)
        d_value = torch.cat([cross(line, query), cross(reference_in_query, query)], 1)
        d_rotation = cross(line, line_xy) + cross(query, cross(reference_xy, baseline))
        d_translation = cross(reference_in_query, line_xy) + cross(reference_xy, query)
        half_d_squared = torch.cat([d_rotation, d_translation], 1)
        jacobian = (d_value - value / squared * half_d_squared) / squared.sqrt()
        return focal * (value / squared.sqrt())[:, 0], focal * jacobian


@dataclass(frozen=True)
class RefinedPose:
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


def refine(start: Pose, photographs: Sequence[Matches], focal: float) -> RefinedPose:
    """Minimize the Sampson errors over all photographs by Levenberg-Marquardt with a Cauchy loss.

    Args:
        start: initial ``cam_from_world`` of the query, float64.
        photographs: matches to each photograph.
        focal: focal length of the query, pixels.
    """
    pose, damping, iterations = start, 1e-3, 0
    error, jacobian = _stack(pose, photographs, focal)
    while iterations < _MAX_STEPS:
        iterations += 1
        scale = CAUCHY_SCALE * _sigma(error)
        weighted = jacobian / (1 + (error / scale) ** 2)[:, None]
        information = weighted.T @ jacobian
        damped = information + damping * torch.diag(information.diagonal() + _TINY)
        step = torch.linalg.solve(damped, -weighted.T @ error)
        candidate = Pose.exp(step) @ pose
        candidate_error, candidate_jacobian = _stack(candidate, photographs, focal)
        if _cost(candidate_error, scale) <= _cost(error, scale):
            pose, error, jacobian = candidate, candidate_error, candidate_jacobian
            damping /= 10
        else:
            damping *= 10
        if float(step.norm()) < _MIN_STEP:
            break
    sigma = _sigma(error)
    weighted = jacobian / (1 + (error / (CAUCHY_SCALE * sigma)) ** 2)[:, None]
    information = weighted.T @ jacobian
    if not float(torch.linalg.cond(information)) < MAX_CONDITION:
        return RefinedPose(pose, None, iterations)
    return RefinedPose(pose, (torch.linalg.inv(information) * sigma**2).numpy(), iterations)


def _stack(pose: Pose, photographs: Sequence[Matches], focal: float) -> tuple[Tensor, Tensor]:
    """Return errors and Jacobians over all photographs."""
    errors, jacobians = zip(*(m.residuals(pose, focal) for m in photographs), strict=True)
    return torch.cat(errors), torch.cat(jacobians)


def _sigma(error: Tensor) -> float:
    """Estimate the standard deviation of residuals (px) from their median, robust to outliers."""
    return max(SIGMA_OF_MEDIAN * float(error.abs().median()), _LEAST_SIGMA)


def _cost(error: Tensor, scale: float) -> float:
    return float(torch.log1p((error / scale) ** 2).sum())
