"""What D2-Net is trained by: descriptors of one place alike and of others not, where detected.

A triplet margin loss whose every triplet weighs as much as the soft scores of its two ends
(section 4 of the paper). Nothing but the better score of good matches teaches detection.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

_MARGIN: Final = 1.0
# Within so many cells (Chebyshev) of the true place, a descriptor is no negative.
_SAFE_RADIUS: Final = 4
# More than any squared distance of unit vectors.
_FAR: Final = 10.0
_TINY: Final = 1e-12


class TripletLoss(NamedTuple):
    """The loss of a pair of images and what to watch beside it, all scalars.

    Attributes:
        loss: mean hinge of margin + positive - negative, weighted by the scores.
        positive: mean squared distance of corresponding descriptors.
        negative: mean squared distance to the hardest other one.
        right: share of correspondences nearer to each other than to all others.
    """

    loss: Tensor
    positive: Tensor
    negative: Tensor
    right: Tensor


def triplet_loss(
    features_a: Tensor,
    scores_a: Tensor,
    features_b: Tensor,
    scores_b: Tensor,
    cells_a: Tensor,
    cells_b: Tensor,
) -> TripletLoss:
    """Loss of one pair of images.

    Args:
        features_a: (C, h, w) of either sign and any length.
        scores_a: (h, w) soft detection scores.
        features_b: (C, h', w') of the other image.
        scores_b: (h', w').
        cells_a: (N, 2) int64 columns and rows of corresponding cells, inside the image; N > 0.
        cells_b: (N, 2) the same of the other image.
    """
    all_a, all_b = _unit_rows(features_a), _unit_rows(features_b)
    rows_a, rows_b = _flat(cells_a, features_a), _flat(cells_b, features_b)
    a, b = all_a[rows_a], all_b[rows_b]
    positive = 2 - 2 * (a * b).sum(1)
    negative = torch.minimum(
        _hardest(a, all_b, cells_b, features_b.shape[2]),
        _hardest(b, all_a, cells_a, features_a.shape[2]),
    )
    weight = scores_a.flatten()[rows_a] * scores_b.flatten()[rows_b]
    hinge = functional.relu(_MARGIN + positive - negative)
    # Scores are of the order of one over the number of cells: their products are small.
    weight = weight / weight.sum().clamp_min(_TINY)
    return TripletLoss(
        (weight * hinge).sum(),
        positive.mean().detach(),
        negative.mean().detach(),
        (positive < negative).float().mean().detach(),
    )


def _unit_rows(features: Tensor) -> Tensor:
    """(C, h, w) as (h * w, C) float32 of unit length."""
    return functional.normalize(features.float().flatten(1).T, dim=1)


def _flat(cells: Tensor, features: Tensor) -> Tensor:
    return cells[:, 1] * features.shape[2] + cells[:, 0]


def _hardest(descriptors: Tensor, others: Tensor, cells: Tensor, columns: int) -> Tensor:
    """Squared distance of each descriptor to the nearest of the other image away from its place.

    Args:
        descriptors: (N, C).
        others: (h * w, C) every cell of the other image.
        cells: (N, 2) where each descriptor belongs in the other image.
        columns: of the other image.
    """
    index = torch.arange(len(others), device=cells.device)
    grid = torch.stack([index % columns, index // columns], -1)
    near = (cells[:, None] - grid).abs().amax(-1) <= _SAFE_RADIUS
    distance = 2 - 2 * descriptors @ others.T
    return torch.where(near, distance + _FAR, distance).amin(1)
