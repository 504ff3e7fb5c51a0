"""What D2-Net is trained by: descriptors of one place alike and of others not, where detected.

A triplet margin loss whose every triplet weighs as much as the soft scores of its two ends
(section 4 of the paper). Nothing but the better score of good matches teaches detection.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from baselines.training.contrastive import sample

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
        cells_a: (N, 2) columns and rows of corresponding places, in cells: the centre of the first
            is (0.5, 0.5). Descriptors and scores between centres are interpolated. N > 0.
        cells_b: (N, 2) the same of the other image.
    """
    a, b = _descriptors(features_a, cells_a), _descriptors(features_b, cells_b)
    positive = 2 - 2 * (a * b).sum(1)
    negative = torch.minimum(_hardest(a, features_b, cells_b), _hardest(b, features_a, cells_a))
    weight = _at(scores_a[None], cells_a)[:, 0] * _at(scores_b[None], cells_b)[:, 0]
    hinge = functional.relu(_MARGIN + positive - negative)
    # Scores are of the order of one over the number of cells: their products are small.
    weight = weight / weight.sum().clamp_min(_TINY)
    return TripletLoss(
        (weight * hinge).sum(),
        positive.mean().detach(),
        negative.mean().detach(),
        (positive < negative).float().mean().detach(),
    )


def _at(values: Tensor, cells: Tensor) -> Tensor:
    """Values (C, h, w) at places (N, 2), in float32. (N, C)."""
    return sample(values[None], cells[None])[0]


def _descriptors(features: Tensor, cells: Tensor) -> Tensor:
    return functional.normalize(_at(features, cells), dim=1)


def _hardest(descriptors: Tensor, features: Tensor, cells: Tensor) -> Tensor:
    """Squared distance of each descriptor to the nearest of another image away from its place.

    Args:
        descriptors: (N, C).
        features: (C, h, w) of the other image.
        cells: (N, 2) where each descriptor belongs in it.
    """
    others = functional.normalize(features.float().flatten(1), dim=0)
    index = torch.arange(others.shape[1], device=cells.device)
    columns = features.shape[2]
    centres = torch.stack([index % columns, index // columns], -1) + 0.5
    near = (cells[:, None] - centres).abs().amax(-1) <= _SAFE_RADIUS
    distance = 2 - 2 * descriptors @ others
    return torch.where(near, distance + _FAR, distance).amin(1)
