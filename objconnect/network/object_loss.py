"""The losses of the object detector: centres, cells, sizes and identities of objects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from objconnect.learning.training.contrastive import sample
from objconnect.learning.training.objects import GROUND, UNKNOWN, ImageObjects
from objconnect.network.detector import DetectorMaps, cell_centres

# Weights that make the losses about equal when the detector begins to find objects.
_SHARES: Final = {"centres": 1.0, "inside": 1.0, "offsets": 0.5, "sides": 0.3, "rises": 0.3}
IDENTITY_SHARE: Final = 0.5
"""Weight of the contrastive loss of vectors in the whole loss."""

# Temperature by which the cosines of vectors are divided in the contrastive loss.
_TEMPERATURE: Final = 0.1
# The detector learns only objects with at least this many visible pixels.
_MIN_PIXELS: Final = 12
# Standard deviation of the Gaussian around a centre in the heat map, as a share of the object's
# side.
_SIGMA_SHARE: Final = 0.17
# Error of an offset that is tolerated, as a share of its length.
_TOLERANCE_SHARE: Final = 0.15
# Numerical guards of logarithms: of probabilities, and of sides (pixels).
_MIN_PROBABILITY, _MIN_SIDE_PX = 1e-4, 0.5


class _Targets(NamedTuple):
    """Target maps of an image.

    Attributes:
        labels: (h, w) row of the object of each cell, ``GROUND`` or ``UNKNOWN``.
        heat: (h, w) 1 at cells with a centre, less around them.
        offset: (2, h, w) cells x y from the cell to the centre of its object.
        log_side: (h, w) logarithm of the side of the object, pixels.
        rise: (h, w) log(1 + height of the centre above ground / side of the object).
        weight: (h, w) weights of cells of objects, 1 / sqrt(number of the object's cells).
    """

    labels: Tensor
    heat: Tensor
    offset: Tensor
    log_side: Tensor
    rise: Tensor
    weight: Tensor


def cell_labels(labels: Tensor, stride: int) -> Tensor:
    """Return the label of each cell (h, w) from the labels of pixels (S, S).

    A cell belongs to the object with the most pixels in it, if these are at least a quarter of the
    cell, because a small object covers no cell entirely. A cell of which more than half is
    ``UNKNOWN`` is unknown. The remaining cells are ``GROUND``.
    """
    height, width = (side // stride for side in labels.shape)
    cut = labels[: height * stride, : width * stride]
    pixels = cut.reshape(height, stride, width, stride).permute(0, 2, 1, 3).flatten(2)
    same_label = (pixels[..., :, None] == pixels[..., None, :]).sum(-1)
    object_pixels = torch.where(pixels >= 0, same_label, 0)
    most, pixel = object_pixels.max(-1)
    unknown = (pixels == UNKNOWN).sum(-1) * 2 > stride**2
    largest = pixels.gather(-1, pixel[..., None])[..., 0]
    known = torch.where(most * 4 >= stride**2, largest, GROUND)
    return torch.where(unknown, UNKNOWN, known).long()


def is_findable(objects: ImageObjects, side: int) -> Tensor:
    """Return whether objects (n,) have their centre in an image of ``side`` pixels and enough
    visible pixels."""
    inside = ((objects.centres > 0) & (objects.centres < side)).all(1)
    return inside & (objects.pixels >= _MIN_PIXELS)


def _targets(objects: ImageObjects, stride: int) -> _Targets:
    labels = cell_labels(objects.labels, stride)
    middle = cell_centres(labels)
    heat = torch.zeros(*labels.shape, device=labels.device)
    centres, cells = objects.centres / stride, objects.sides / stride
    found = is_findable(objects, len(objects.labels))
    sigmas = (cells * _SIGMA_SHARE).clamp(0.6, 4.0)
    for centre, sigma in zip(centres[found], sigmas[found], strict=True):
        centre_cell = centre.floor() + 0.5
        squared = (middle - centre_cell[:, None, None]).square().sum(0)
        heat = torch.maximum(heat, torch.exp(-squared / (2 * sigma**2)))
    has_object = labels >= 0
    # Cells without an object get the values of the first object, with zero weight.
    owner = labels.clamp(min=0)

    def paint(values: Tensor) -> Tensor:
        empty = torch.zeros(1, *values.shape[1:], device=values.device)
        return (values if len(values) else empty)[owner]

    count = torch.bincount(labels[has_object], minlength=max(len(cells), 1)).clamp(min=1).float()
    return _Targets(
        labels,
        heat,
        paint(centres).permute(2, 0, 1) - middle,
        paint(objects.sides.clamp_min(_MIN_SIDE_PX).log()),
        paint((objects.rises / objects.sides.clamp_min(_MIN_SIDE_PX)).log1p()),
        has_object / count.sqrt()[owner],
    )


def geometry_loss(
    maps: DetectorMaps, objects: Sequence[ImageObjects], stride: int
) -> tuple[Tensor, dict[str, float]]:
    """Return the loss of centres, cells, offsets, sides and rises of B images, and values to log.

    It is CenterNet's focal loss for centres, the cross entropy for cells, and the smooth L1
    distance over the cells of objects for the rest.
    """
    targets = [_targets(each, stride) for each in objects]
    labels, heat, offset, log_side, rise, weight = map(torch.stack, zip(*targets, strict=True))
    known = labels != UNKNOWN
    p = torch.sigmoid(maps.centre.float()).clamp(_MIN_PROBABILITY, 1 - _MIN_PROBABILITY)
    is_centre = (heat > 1 - _MIN_PROBABILITY) & known
    positive = ((1 - p).square() * p.log())[is_centre].sum()
    negative = ((1 - heat) ** 4 * p.square() * (1 - p).log())[~is_centre & known].sum()
    total = weight.sum().clamp(min=1)

    def distance(predicted: Tensor, true: Tensor) -> Tensor:
        error = functional.smooth_l1_loss(predicted.float(), true, reduction="none")
        return (error * weight).sum() / total

    # The tolerance of an offset grows with its length.
    tolerance = 1 + _TOLERANCE_SHARE * offset.abs().sum(1)
    offset_loss = distance(maps.offset[:, 0] / tolerance, offset[:, 0] / tolerance)
    offset_loss = offset_loss + distance(maps.offset[:, 1] / tolerance, offset[:, 1] / tolerance)
    losses = {
        "centres": -(positive + negative) / is_centre.sum().clamp(min=1),
        "inside": functional.binary_cross_entropy_with_logits(
            maps.inside.float()[known], (labels >= 0).float()[known]
        ),
        "offsets": offset_loss,
        "sides": distance(maps.log_side, log_side),
        "rises": distance(maps.rise, rise),
    }
    loss = torch.stack([_SHARES[name] * each for name, each in losses.items()]).sum()
    return loss, {name: float(each.detach()) for name, each in losses.items()}


def identity_loss(
    maps: DetectorMaps, objects: Sequence[ImageObjects], stride: int
) -> tuple[Tensor, float]:
    """Return the contrastive loss of the vectors at the true centres of objects, and the share of
    positives that are more similar than all negatives.

    The positive of an object is the same object in another image of the batch. All other objects
    of the batch are negatives.
    """
    vectors, ids, images = [], [], []
    side = maps.vector.shape[-1] * stride
    for number, each in enumerate(objects):
        found = is_findable(each, side)
        cells = each.centres[found] / stride
        vectors.append(sample(maps.vector[number : number + 1], cells[None])[0])
        ids.append(each.ids[found])
        images.append(torch.full_like(each.ids[found], number))
    unit, identity, image = torch.cat(vectors), torch.cat(ids), torch.cat(images)
    unit = functional.normalize(unit, dim=1)
    same = identity[:, None] == identity[None]
    positive = same & (image[:, None] != image[None])
    if not bool(positive.any()):
        return unit.sum() * 0, 0.0
    similarity = unit @ unit.T / _TEMPERATURE
    negatives = similarity.masked_fill(same, -torch.inf)
    losses = torch.logaddexp(similarity, negatives.logsumexp(1)[:, None]) - similarity
    is_first = similarity > negatives.max(1).values[:, None]
    return losses[positive].mean(), float(is_first[positive].float().mean())
