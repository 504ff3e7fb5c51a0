"""Headings and tilts that a search tries, given a prior."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from objconnect.scene.config import Config
from objconnect.scene.geometry.pose import so3_exp
from objconnect.scene.localizer import Prior

_DOWN: Final = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))

NO_TILT: Final = torch.eye(3, dtype=torch.float64)
"""The identity: the rotation that adds no tilt."""
TILTS_DEG: Final = (0.0, 15.0, 30.0, 45.0, 60.0)
"""Default tilts of the camera, degrees, to try where the attitude is unknown."""


class TiltOptions(Config):
    """Tilts of the camera that a search tries."""

    tilts_deg: tuple[Annotated[float, Field(ge=0, le=75)], ...] = Field(
        TILTS_DEG,
        min_length=1,
        description="Angles between the optical axis and straight down that are tried if the "
        "attitude is unknown, deg. The coarse search tries the angles after the first only if no "
        "candidate at the first is accepted.",
    )


def tilt_rotations(tilts_deg: Sequence[float]) -> list[Tensor]:
    """Return rotations (3, 3) that tilt a camera which looks straight down, in its own axes.

    A tilted camera looks ahead: nearer ground is lower in its picture.
    """
    radians = (math.radians(degrees) for degrees in tilts_deg)
    return [so3_exp(torch.tensor([-tilt, 0.0, 0.0]).double()) for tilt in radians]


def has_attitude(prior: Prior | None) -> bool:
    """Return whether a prior has an attitude, so that no tilt is searched."""
    return prior is not None and prior.cam_from_world_rotation is not None


def possible_headings(prior: Prior | None, count: int) -> tuple[Tensor, list[float]]:
    """Return an attitude, and rotations about the vertical (rad) that give the headings to try.

    They cover at least two standard deviations to either side of the prior's heading, or the full
    circle if the heading or its standard deviation is unknown.

    Args:
        prior: prior of the query; without an attitude the camera is assumed to look straight down.
        count: number of headings on the full circle.

    Returns:
        The attitude, a ``cam_from_world`` rotation (3, 3), and the rotations from its heading.
    """
    step = math.tau / count
    full_circle = [k * step for k in range(count)]
    if prior is None or prior.cam_from_world_rotation is None:
        return _DOWN, full_circle
    attitude = torch.from_numpy(np.array(prior.cam_from_world_rotation, np.float64))
    degrees = prior.heading_sigma_deg
    degrees = prior.attitude_sigma_deg if degrees is None else degrees
    if degrees is None:
        return attitude, full_circle
    steps = math.ceil(min(2 * math.radians(degrees) / step, count))
    if 2 * steps >= count:  # The last headings to the left and right would be the same.
        return attitude, full_circle
    return attitude, [k * step for k in range(-steps, steps + 1)]
