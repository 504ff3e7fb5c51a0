"""Headings and altitudes to search for a prior."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import torch
from torch import Tensor

from objconnect.scene.localizer import Prior

_DOWN: Final = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))

ALTITUDES: Final = (0.5, 0.6, 0.72, 0.87, 1.04, 1.25, 1.5)
"""Heights above ground to try where none is known, relative to that of the map's photographs; they
are a fifth apart, because features tolerate a tenth."""


def possible_headings(prior: Prior | None, count: int) -> tuple[Tensor, list[float]]:
    """Return an attitude and the headings around it (rad) within two standard deviations.

    Args:
        prior: prior of the query; without an attitude the camera is assumed to look straight down.
        count: number of headings over the full turn.

    Returns:
        The ``cam_from_world`` rotation (3, 3) at a heading of 0, and the headings.
    """
    step = math.tau / count
    around = [k * step for k in range(count)]
    if prior is None or prior.cam_from_world_rotation is None:
        return _DOWN, around
    attitude = torch.from_numpy(np.array(prior.cam_from_world_rotation, np.float64))
    degrees = prior.heading_sigma_deg
    degrees = prior.attitude_sigma_deg if degrees is None else degrees
    if degrees is None:
        return attitude, around
    most = math.ceil(min(2 * math.radians(degrees) / step, count))
    if 2 * most >= count:  # The last ones to the left and right would be the same.
        return attitude, around
    return attitude, [k * step for k in range(-most, most + 1)]
