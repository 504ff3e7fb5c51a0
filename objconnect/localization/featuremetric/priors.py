"""What a prior says of a query, and how far to look around it."""

from __future__ import annotations

from typing import Final

import numpy as np
import torch

from objconnect.localization.align.options import SearchRadius
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Prior

AROUND: Final = SearchRadius(8.0, 10.0)
"""How far to look around a start of which no uncertainty is known."""
# The farthest to look around a start: a wider grid has gaps.
_FARTHEST: Final = SearchRadius(40.0, 30.0)
# Standard deviations of a prior that a search reaches.
_PRIOR_SIGMAS: Final = 2.0
# Standard deviations of a prior's position within which a place of objects may be.
_PLACE_SIGMAS: Final = 3.0


def exact_prior(pose: Pose) -> Prior:
    """Return a prior that knows position and attitude."""
    return Prior(pose.centre().numpy(), cam_from_world_rotation=pose.rotation.numpy())


def pose_of(prior: Prior) -> Pose:
    """Return the pose of a prior that knows position and attitude."""
    assert prior.position is not None and prior.cam_from_world_rotation is not None
    rotation = torch.tensor(prior.cam_from_world_rotation, dtype=torch.float64)
    centre = torch.tensor(prior.position, dtype=torch.float64)
    return Pose(rotation, -rotation @ centre)


def says_where(prior: Prior | None) -> bool:
    """Return whether a prior says where the camera is."""
    return prior is not None and prior.has_position


def says_all(prior: Prior | None) -> bool:
    """Return whether a prior says where the camera is and which way it is turned."""
    return prior is not None and prior.has_position and prior.has_heading


def may_be_at(prior: Prior | None, pose: Pose) -> bool:
    """Return whether a prior's position, as far as it is sure, allows a pose."""
    if prior is None or prior.horizontal_sigma is None:
        return True
    away = np.linalg.norm(pose.centre().numpy()[:2] - prior.position[:2])
    return bool(away <= AROUND.metres + _PLACE_SIGMAS * prior.horizontal_sigma)


def search_radius(prior: Prior | None) -> SearchRadius:
    """Return how far a prior may be off, by its standard deviations where they are known."""
    if prior is None:
        return AROUND
    metres = AROUND.metres
    if prior.position_sigma is not None:
        # An axis that was not measured is infinitely unsure: nothing says how far to look.
        known = prior.position_sigma[:2][np.isfinite(prior.position_sigma[:2])]
        metres = max([metres, *(_PRIOR_SIGMAS * float(sigma) for sigma in known)])
    degrees = max(AROUND.degrees, _PRIOR_SIGMAS * (prior.attitude_sigma_deg or 0.0))
    return SearchRadius(min(metres, _FARTHEST.metres), min(degrees, _FARTHEST.degrees))
