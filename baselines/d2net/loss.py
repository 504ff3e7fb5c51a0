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
from baselines.training.options import LOSSES, LossOptions

# Numerical guards. More than any squared distance of unit vectors.
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


class Described(NamedTuple):
    """One image of a pair, and the places in it that correspond to places of the other.

    Attributes:
        features: (C, h, w) of either sign and any length.
        scores: (h, w) soft detection scores.
        cells: (N, 2) columns and rows of the places, in cells: the centre of the first is
            (0.5, 0.5). Descriptors and scores between centres are interpolated. N > 0.
    """

    features: Tensor
    scores: Tensor
    cells: Tensor


def triplet_loss(
    image_a: Described, image_b: Described, options: LossOptions = LOSSES
) -> TripletLoss:
    """Loss of one pair of images of corresponding places, in the same order."""
    a = _descriptors(image_a.features, image_a.cells)
    b = _descriptors(image_b.features, image_b.cells)
    positive = 2 - 2 * (a * b).sum(1)
    radius = options.triplet_safe_radius
    negative = torch.minimum(
        _hardest(a, image_b.features, image_b.cells, radius),
        _hardest(b, image_a.features, image_a.cells, radius),
    )
    score_a, score_b = (_at(each.scores[None], each.cells)[:, 0] for each in (image_a, image_b))
    weight = score_a * score_b
    hinge = functional.relu(options.triplet_margin + positive - negative)
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


def _hardest(descriptors: Tensor, features: Tensor, cells: Tensor, safe_radius: int) -> Tensor:
    """Squared distance of each descriptor to the nearest of another image away from its place.

    Args:
        descriptors: (N, C).
        features: (C, h, w) of the other image.
        cells: (N, 2) where each descriptor belongs in it.
        safe_radius: descriptors within so many cells (Chebyshev) of that place do not count.
    """
    others = functional.normalize(features.float().flatten(1), dim=0)
    index = torch.arange(others.shape[1], device=cells.device)
    columns = features.shape[2]
    centres = torch.stack([index % columns, index // columns], -1) + 0.5
    near = (cells[:, None] - centres).abs().amax(-1) <= safe_radius
    distance = 2 - 2 * descriptors @ others
    return torch.where(near, distance + _FAR, distance).amin(1)
