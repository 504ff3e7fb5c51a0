"""The contrastive loss of dense features, which needs no pose.

It is InfoNCE (van den Oord et al., 2018). The positive of a point's feature in image a is the
feature of the same point in image b. The negatives are features at random positions of image b and
at positions a few cells of the feature map from the point.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

# Temperature by which cosines are divided.
_TEMPERATURE: Final = 0.07
# Number of negatives at random positions of the image.
_RANDOM_NEGATIVES: Final = 512
# Distances (cells) of the near negatives from the true position. They make the peak of the
# similarity sharp, and wide enough for the alignment to converge.
_NEAR_DISTANCES: Final = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)
# Least distance (cells) of a random negative from the true position.
_MIN_DISTANCE: Final = 1.0


def sample(maps: Tensor, cells: Tensor) -> Tensor:
    """Sample maps (B, C, h, w) bilinearly at cells (B, N, 2) x y; returns (B, N, C) float32.

    The centre of the first cell is (0.5, 0.5). Positions outside take the value at the border.
    """
    height, width = maps.shape[-2:]
    scale = cells.new_tensor([2 / width, 2 / height])
    grid = (cells * scale - 1)[:, None]
    sampled = functional.grid_sample(maps.float(), grid, "bilinear", "border", align_corners=False)
    return sampled[:, :, 0].transpose(1, 2)


def contrastive_loss(
    features_a: Tensor,
    features_b: Tensor,
    cells_a: Tensor,
    cells_b: Tensor,
    valid: Tensor,
) -> Tensor:
    """Return the negative log-likelihood that each point is matched at its true position, (B, N).

    Args:
        features_a: features (B, C, h, w) of image a, of any norm; they are normalised here.
        features_b: features of image b.
        cells_a: positions (B, N, 2) of the points in image a, cells.
        cells_b: positions of the points in image b.
        valid: (B, N) bool; the results for other points have no meaning.
    """
    # Positions of invalid points may be NaN. Sampling there would crash.
    cells_a, cells_b = (torch.where(valid[..., None], c, 0.5) for c in (cells_a, cells_b))
    points = functional.normalize(sample(features_a, cells_a), dim=-1)
    batch, channels, height, width = features_b.shape
    count = min(_RANDOM_NEGATIVES, height * width)
    random = torch.randint(height * width, (batch, count), device=cells_b.device)
    distance = cells_b.new_tensor(_NEAR_DISTANCES)
    angle = 2 * torch.pi * torch.rand(*cells_b.shape[:2], len(distance), device=cells_b.device)
    ring = distance[:, None] * torch.stack([angle.cos(), angle.sin()], -1)
    # The true position first, then the positions near it.
    near_cells = torch.cat([cells_b[:, :, None], cells_b[:, :, None] + ring], 2)
    near = functional.normalize(sample(features_b, near_cells.flatten(1, 2)), dim=-1)
    to_near = (points[:, :, None] * near.view(*near_cells.shape[:3], channels)).sum(-1)
    index = random[:, None].expand(-1, channels, -1)
    far = functional.normalize(features_b.flatten(2).gather(2, index).float(), dim=1)
    centres = torch.stack([random % width, random // width], -1) + 0.5
    too_close = torch.cdist(cells_b, centres) < _MIN_DISTANCE
    to_far = (points @ far).masked_fill(too_close, -torch.inf)
    logits = torch.cat([to_near, to_far], -1) / _TEMPERATURE
    return torch.as_tensor(logits.logsumexp(-1) - logits[..., 0])


def mean_over(valid: Tensor, values: Tensor) -> Tensor:
    """Return the mean of values (B, N) over the valid points, a scalar."""
    return torch.where(valid, values, 0).sum() / valid.sum().clamp(min=1)
