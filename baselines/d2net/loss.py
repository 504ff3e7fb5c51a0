"""The loss of D2-Net (section 4 of the paper).

It is a triplet margin loss, weighted by the product of the soft detection scores of the two
keypoints. The weight also trains detection: good matches get higher scores.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from objconnect.learning.training.contrastive import sample

# Margin of the squared distances; the value of the authors.
_MARGIN: Final = 1.0
# Negatives are farther than this Chebyshev distance (cells) from the true match.
_SAFE_RADIUS: Final = 4
# Numerical guards; the first exceeds any squared distance of unit vectors.
_FAR: Final = 10.0
_TINY: Final = 1e-12


class TripletLoss(NamedTuple):
    """The loss of a pair of images and values for the log, all scalars.

    Attributes:
        loss: mean hinge of margin + positive - negative, weighted by the scores.
        positive: mean squared distance of corresponding descriptors.
        negative: mean squared distance to the hardest negative.
        right: share of correspondences that are nearer to each other than to any negative.
    """

    loss: Tensor
    positive: Tensor
    negative: Tensor
    right: Tensor


class ImagePoints(NamedTuple):
    """One image of a pair with the points that correspond to points of the other.

    Attributes:
        features: features (C, h, w), of either sign and any length.
        scores: soft detection scores (h, w).
        cells: columns and rows (N, 2) of the points, N > 0. The centre of the first cell is
            (0.5, 0.5). Descriptors and scores are interpolated.
    """

    features: Tensor
    scores: Tensor
    cells: Tensor


def triplet_loss(image_a: ImagePoints, image_b: ImagePoints) -> TripletLoss:
    """Return the loss of one pair of images, whose points correspond by their order."""
    a = _descriptors(image_a.features, image_a.cells)
    b = _descriptors(image_b.features, image_b.cells)
    positive = 2 - 2 * (a * b).sum(1)
    negative = torch.minimum(
        _hardest_distance(a, image_b.features, image_b.cells),
        _hardest_distance(b, image_a.features, image_a.cells),
    )
    score_a, score_b = (
        _sample_at(each.scores[None], each.cells)[:, 0] for each in (image_a, image_b)
    )
    weight = score_a * score_b
    hinge = functional.relu(_MARGIN + positive - negative)
    # Scores are about one over the number of cells, so their products are tiny and are normalised.
    weight = weight / weight.sum().clamp_min(_TINY)
    return TripletLoss(
        (weight * hinge).sum(),
        positive.mean().detach(),
        negative.mean().detach(),
        (positive < negative).float().mean().detach(),
    )


def _sample_at(values: Tensor, cells: Tensor) -> Tensor:
    """Sample values (C, h, w) at cells (N, 2); returns (N, C) float32."""
    return sample(values[None], cells[None])[0]


def _descriptors(features: Tensor, cells: Tensor) -> Tensor:
    return functional.normalize(_sample_at(features, cells), dim=1)


def _hardest_distance(descriptors: Tensor, features: Tensor, cells: Tensor) -> Tensor:
    """Return the squared distance (N,) of each descriptor to its hardest negative.

    Args:
        descriptors: descriptors (N, C) of one image.
        features: features (C, h, w) of the other image.
        cells: position (N, 2) in the other image of each descriptor's true match.
    """
    others = functional.normalize(features.float().flatten(1), dim=0)
    index = torch.arange(others.shape[1], device=cells.device)
    columns = features.shape[2]
    centres = torch.stack([index % columns, index // columns], -1) + 0.5
    near = (cells[:, None] - centres).abs().amax(-1) <= _SAFE_RADIUS
    distance = 2 - 2 * descriptors @ others
    return torch.where(near, distance + _FAR, distance).amin(1)
