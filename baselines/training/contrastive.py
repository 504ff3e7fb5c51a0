"""The loss that teaches features to tell places apart before any pose is solved with them.

InfoNCE (van den Oord et al., 2018) of a point's feature in one image against its own place in the
other, other places of that image, and places a few cells beside its own.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

_TEMPERATURE: Final = 0.07
_ELSEWHERE: Final = 1024
# Offsets (cells) beside the true place: they make the peak sharp, and wide enough to be climbed.
_BESIDE: Final = (1.0, 2.0, 4.0, 8.0)
_SAME_PLACE: Final = 1.0


def sample(maps: Tensor, cells: Tensor) -> Tensor:
    """Bilinear lookup. Maps (B, C, h, w), cells (B, N, 2) x y -> (B, N, C) float32.

    The centre of the first cell is (0.5, 0.5); what lies outside takes the border's value.
    """
    height, width = maps.shape[-2:]
    scale = cells.new_tensor([2 / width, 2 / height])
    grid = (cells * scale - 1)[:, None]
    found = functional.grid_sample(maps.float(), grid, "bilinear", "border", align_corners=False)
    return found[:, :, 0].transpose(1, 2)


def contrastive(
    features_a: Tensor, features_b: Tensor, cells_a: Tensor, cells_b: Tensor, valid: Tensor
) -> Tensor:
    """Mean over points of the negative logarithm of how likely a point is found at its own place.

    Args:
        features_a: (B, C, h, w), of any length: they are normalised here.
        features_b: likewise.
        cells_a: (B, N, 2) where the points lie in a, cells.
        cells_b: (B, N, 2) likewise in b.
        valid: (B, N) bool.
    """
    points = functional.normalize(sample(features_a, cells_a), dim=-1)
    batch, _, height, width = features_b.shape
    count = min(_ELSEWHERE, height * width)
    corner = cells_b.new_tensor([width, height])
    elsewhere = torch.rand(batch, count, 2, device=cells_b.device) * corner
    angles = torch.arange(6, device=cells_b.device) * (torch.pi / 3)
    ring = torch.stack([angles.cos(), angles.sin()], -1)
    offsets = torch.cat([ring * radius for radius in _BESIDE])
    beside = (cells_b[:, :, None] + offsets).flatten(1, 2)
    places = torch.cat([cells_b, beside, elsewhere], 1)
    found = functional.normalize(sample(features_b, places), dim=-1)
    own, near, far = torch.tensor_split(found, [cells_b.shape[1], len(places[0]) - count], 1)
    near = near.view(batch, -1, len(offsets), near.shape[-1])
    to_own = (points * own).sum(-1, keepdim=True)
    to_near = (points[:, :, None] * near).sum(-1)
    to_far = points @ far.transpose(1, 2)
    too_close = torch.cdist(cells_b, elsewhere) < _SAME_PLACE
    to_far = to_far.masked_fill(too_close, -torch.inf)
    logits = torch.cat([to_own, to_near, to_far], -1) / _TEMPERATURE
    loss = logits.logsumexp(-1) - logits[..., 0]
    return (loss * valid).sum() / valid.sum().clamp(min=1)
