"""Pictures with objects in them."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from tests.objconnect.learning.training.made_pairs import picture


def pictures(batch: int, height: int, width: int) -> Tensor:
    """(B, 3, H, W) in 0..1."""
    stack = np.stack([picture(height, width, seed) for seed in range(batch)])
    return torch.from_numpy(stack).permute(0, 3, 1, 2).float() / 255
