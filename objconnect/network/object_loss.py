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
"""Weight of the contrastive loss of vectors."""

# Temperature that divides the cosines of vectors.
_TEMPERATURE: Final = 0.1
# Least number of visible pixels of an object that is to be detected.
_MIN_PIXELS: Final = 12
# Standard deviation of a centre in the heat map as a share of the object's side.
_SPREAD: Final = 0.17
# Share of an offset's length that counts as its uncertainty.
_FAR_SHARE: Final = 0.15
# Numerical guards of logarithms.
_LEAST, _LEAST_SIDE = 1e-4, 0.5


class _Targets(NamedTuple):
    """Target maps of an image.

    Attributes:
        labels: (h, w) row of the object of each cell, ``GROUND`` or ``UNKNOWN``.
        heat: (h, w) 1 at cells with a centre, less around them.
        offset: (2, h, w) cells to the centre of the object.
        log_side: (h, w) logarithm of the side, pixels.
        rise: (h, w) logarithm of one plus the height of the centre, in sides.
        weight: (h, w) weights of cells of objects, 1 / sqrt(number of the object's cells).
    """

    labels: Tensor
    heat: Tensor
    offset: Tensor
    log_side: Tensor
    rise: Tensor
    weight: Tensor


def cell_labels(labels: Tensor, stride: int) -> Tensor:
    """Return the label of each cell (h, w) from those of pixels (S, S).

    The object with most pixels in a cell gives its label if it covers at least a quarter of it:
    small objects cover no cell entirely.
    """
    height, width = (side // stride for side in labels.shape)
    cut = labels[: height * stride, : width * stride]
    pixels = cut.reshape(height, stride, width, stride).permute(0, 2, 1, 3).flatten(2)
    same = (pixels[..., :, None] == pixels[..., None, :]).sum(-1)
    objects = torch.where(pixels >= 0, same, 0)
    most, at = objects.max(-1)
    unknown = (pixels == UNKNOWN).sum(-1) * 2 > stride**2
    found = torch.where(most * 4 >= stride**2, pixels.gather(-1, at[..., None])[..., 0], GROUND)
    return torch.where(unknown, UNKNOWN, found).long()


def is_findable(objects: ImageObjects, side: int) -> Tensor:
    """Return whether objects (n,) are visible enough in an image of ``side`` pixels."""
    inside = ((objects.centres > 0) & (objects.centres < side)).all(1)
    return inside & (objects.pixels >= _MIN_PIXELS)


def _targets(objects: ImageObjects, stride: int) -> _Targets:
    labels = cell_labels(objects.labels, stride)
    middle = cell_centres(labels)
    heat = torch.zeros(*labels.shape, device=labels.device)
    centres, cells = objects.centres / stride, objects.sides / stride
    found = is_findable(objects, len(objects.labels))
    spread = (cells * _SPREAD).clamp(0.6, 4.0)
    for centre, sigma in zip(centres[found], spread[found], strict=True):
        holds = centre.floor() + 0.5
        away = (middle - holds[:, None, None]).square().sum(0)
        heat = torch.maximum(heat, torch.exp(-away / (2 * sigma**2)))
    shown = labels >= 0
    # Cells without an object get the values of the first one, with zero weight.
    of = labels.clamp(min=0)

    def paint(values: Tensor) -> Tensor:
        empty = torch.zeros(1, *values.shape[1:], device=values.device)
        return (values if len(values) else empty)[of]

    count = torch.bincount(labels[shown], minlength=max(len(cells), 1)).clamp(min=1).float()
    return _Targets(
        labels,
        heat,
        paint(centres).permute(2, 0, 1) - middle,
        paint(objects.sides.clamp_min(_LEAST_SIDE).log()),
        paint((objects.rises / objects.sides.clamp_min(_LEAST_SIDE)).log1p()),
        shown / count.sqrt()[of],
    )


def place_loss(
    maps: DetectorMaps, objects: Sequence[ImageObjects], stride: int
) -> tuple[Tensor, dict[str, float]]:
    """Return the loss of centres, cells, offsets, sides and rises of B images, and log values.

    It is CenterNet's focal loss for centres, the cross entropy for cells, and the smooth L1
    distance over the cells of objects for the rest.
    """
    targets = [_targets(each, stride) for each in objects]
    labels, heat, offset, log_side, rise, weight = map(torch.stack, zip(*targets, strict=True))
    known = labels != UNKNOWN
    p = torch.sigmoid(maps.centre.float()).clamp(_LEAST, 1 - _LEAST)
    holds = (heat > 1 - _LEAST) & known
    missed = ((1 - p).square() * p.log())[holds].sum()
    mistaken = ((1 - heat) ** 4 * p.square() * (1 - p).log())[~holds & known].sum()
    total = weight.sum().clamp(min=1)

    def distance(said: Tensor, true: Tensor) -> Tensor:
        away = functional.smooth_l1_loss(said.float(), true, reduction="none")
        return (away * weight).sum() / total

    # The tolerance of an offset grows with its length.
    far = 1 + _FAR_SHARE * offset.abs().sum(1)
    pointing = distance(maps.offset[:, 0] / far, offset[:, 0] / far)
    pointing = pointing + distance(maps.offset[:, 1] / far, offset[:, 1] / far)
    losses = {
        "centres": -(missed + mistaken) / holds.sum().clamp(min=1),
        "inside": functional.binary_cross_entropy_with_logits(
            maps.inside.float()[known], (labels >= 0).float()[known]
        ),
        "offsets": pointing,
        "sides": distance(maps.log_side, log_side),
        "rises": distance(maps.rise, rise),
    }
    loss = torch.stack([_SHARES[name] * each for name, each in losses.items()]).sum()
    return loss, {name: float(each.detach()) for name, each in losses.items()}


def identity_loss(
    maps: DetectorMaps, objects: Sequence[ImageObjects], stride: int
) -> tuple[Tensor, float]:
    """Return the contrastive loss of the vectors at true centres, and the recall at rank 1.

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
    own, name, image = torch.cat(vectors), torch.cat(ids), torch.cat(images)
    own = functional.normalize(own, dim=1)
    same = name[:, None] == name[None]
    positive = same & (image[:, None] != image[None])
    if not bool(positive.any()):
        return own.sum() * 0, 0.0
    alike = own @ own.T / _TEMPERATURE
    negative = alike.masked_fill(same, -torch.inf).logsumexp(1)
    lost = torch.logaddexp(alike, negative[:, None]) - alike
    first = alike > alike.masked_fill(same, -torch.inf).max(1).values[:, None]
    return lost[positive].mean(), float(first[positive].float().mean())
