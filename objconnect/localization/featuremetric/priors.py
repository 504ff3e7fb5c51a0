"""Completeness of priors, and the search radius around them."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import torch

from objconnect.localization.align.options import SearchRadius
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Prior

DEFAULT_RADIUS: Final = SearchRadius(8.0, 10.0)
"""Search radius (metres, degrees) around an initial pose of unknown uncertainty."""
# Largest search radius (metres, degrees), because the grid of a wider search would have gaps.
_LARGEST_RADIUS: Final = SearchRadius(40.0, 30.0)
# Search radius in standard deviations of a prior.
_PRIOR_SIGMAS: Final = 2.0
# Candidates are accepted within this many standard deviations of a prior's position, plus the
# metres of ``DEFAULT_RADIUS``.
_CANDIDATE_SIGMAS: Final = 3.0


def exact_prior(pose: Pose) -> Prior:
    """Return the prior of a known position and attitude."""
    return Prior(pose.centre().numpy(), cam_from_world_rotation=pose.rotation.numpy())


def pose_of(prior: Prior) -> Pose:
    """Return the pose of a prior with position and attitude."""
    assert prior.position is not None and prior.cam_from_world_rotation is not None
    rotation = torch.tensor(prior.cam_from_world_rotation, dtype=torch.float64)
    centre = torch.tensor(prior.position, dtype=torch.float64)
    return Pose(rotation, -rotation @ centre)


def has_position(prior: Prior | None) -> bool:
    """Return whether there is a prior with a position."""
    return prior is not None and prior.has_position


def has_pose(prior: Prior | None) -> bool:
    """Return whether there is a prior with a position and a heading."""
    return prior is not None and prior.has_position and prior.has_heading


def region(prior: Prior | None) -> tuple[float, float, float] | None:
    """Return the region of a prior's position: east, north and radius, metres.

    It is None if the position or its sigma is unknown.
    """
    if prior is None or prior.horizontal_sigma is None:
        return None
    east, north = (float(each) for each in prior.position[:2])
    return east, north, DEFAULT_RADIUS.metres + _CANDIDATE_SIGMAS * prior.horizontal_sigma


def is_near_prior(prior: Prior | None, pose: Pose) -> bool:
    """Return whether a pose agrees with a prior's position; True if its sigma is unknown."""
    if (around := region(prior)) is None:
        return True
    east, north, _ = pose.centre().tolist()
    return math.hypot(east - around[0], north - around[1]) <= around[2]


def search_radius(prior: Prior | None) -> SearchRadius:
    """Return the search radius around a prior, from its standard deviations if they are known."""
    if prior is None:
        return DEFAULT_RADIUS
    metres = DEFAULT_RADIUS.metres
    if prior.position_sigma is not None:
        # An axis that was not measured has an infinite sigma and does not widen the search.
        known = prior.position_sigma[:2][np.isfinite(prior.position_sigma[:2])]
        metres = max([metres, *(_PRIOR_SIGMAS * float(sigma) for sigma in known)])
    degrees = max(DEFAULT_RADIUS.degrees, _PRIOR_SIGMAS * (prior.attitude_sigma_deg or 0.0))
    return SearchRadius(min(metres, _LARGEST_RADIUS.metres), min(degrees, _LARGEST_RADIUS.degrees))
