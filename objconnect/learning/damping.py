"""Learned damping of the alignment: one factor for each direction of the pose."""

from __future__ import annotations

import torch
from torch import Tensor, nn

# Range of the decimal logarithm of a factor; trained weights depend on it.
_LOG_RANGE = (-6.0, 5.0)


class Damping(nn.Module):
    """Learned damping of one level: a factor per direction, 1e-6 to 1e5, initially 0.3."""

    def __init__(self) -> None:
        super().__init__()
        self.theta = nn.Parameter(torch.zeros(6))

    def forward(self) -> Tensor:
        """Return factors (6,) on the Hessian's diagonal: rotation, then translation."""
        return damping_factors(self.theta)


def damping_factors(theta: Tensor) -> Tensor:
    """Map learned parameters (..., 6) of any value to factors on the Hessian's diagonal."""
    low, high = _LOG_RANGE
    return 10 ** (low + (high - low) * torch.sigmoid(theta))
