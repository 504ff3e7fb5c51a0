"""Losses and parameter groups that train networks with features for alignment."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from objconnect.learning.training.contrastive import contrastive_loss, mean_over, sample
from objconnect.learning.training.options import LOSSES, LossOptions
from objconnect.learning.training.pairs import PairBatch
from objconnect.learning.training.pose_loss import (
    VisiblePoints,
    convert_to_pixels,
    reprojection_error,
)
from objconnect.localization.align.aligner import align
from objconnect.localization.align.options import Options
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import Level
from objconnect.scene.geometry.pose import Pose

# Numerical guard: confidences are clamped to this distance from 0 and 1 before the logarithm.
_CONFIDENCE_MARGIN: Final = 1e-3
# Unrolled iterations of the alignment per level, for the pose loss.
_ITERATIONS: Final = 8
# Learning rate of the damping relative to the rate of the convolution filters. It is large because
# all pixels share a factor.
_DAMPING_RATE: Final = 30.0


def half_precision(batch: PairBatch) -> torch.autocast:
    """Return the bfloat16 context for the network; losses and alignment run outside of it."""
    return torch.autocast(batch.image_a.device.type, torch.bfloat16)


def stack_images(batch: PairBatch) -> Tensor:
    """Return the images a, then the images b, (2B, 3, S, S), channels-last in memory."""
    images = torch.cat([batch.image_a, batch.image_b])
    return images.to(memory_format=torch.channels_last)


def points_in_b(batch: PairBatch) -> VisiblePoints:
    """Return the points of a batch in view of the cameras b."""
    return VisiblePoints(batch.points, batch.intrinsics_b, batch.valid)


def contrastive_and_confidence_loss(
    maps: Sequence[tuple[Tensor, Tensor]],
    strides: Sequence[int],
    batch: PairBatch,
    options: LossOptions = LOSSES,
) -> tuple[Tensor, dict[str, float]]:
    """Return the contrastive loss plus the loss of the confidence, means over levels, and the
    values to log.

    The confidence is trained to predict, from one image, the probability that a point is matched.
    Points that look different in snow or at another hour of the day then have small weights. If the
    confidence is trained by the pose loss alone, as in PixLoc, it stays uniform for a long time.

    Args:
        maps: features (2B, C, h, w) and confidences (2B, 1, h, w) of the images a, then of the
            images b, level by level.
        strides: strides of the levels.
        batch: the B pairs.
        options: weights of the losses.
    """
    losses, confidence_losses = [], []
    for stride, (features, confidence) in zip(strides, maps, strict=True):
        a, b = features.float().chunk(2)
        cells = batch.xy_a / stride, batch.xy_b / stride
        negative_log = contrastive_loss(a, b, *cells, batch.valid)
        losses.append(mean_over(batch.valid, negative_log))
        probability = torch.exp(-negative_log.detach())
        for half, xy in zip(confidence.chunk(2), cells, strict=True):
            predicted = sample(half, xy)[..., 0]
            predicted = predicted.clamp(_CONFIDENCE_MARGIN, 1 - _CONFIDENCE_MARGIN)
            entropy = functional.binary_cross_entropy(predicted, probability, reduction="none")
            confidence_losses.append(mean_over(batch.valid, entropy))
    log_values = {
        f"contrastive/{stride}": float(loss.detach())
        for stride, loss in zip(strides, losses, strict=True)
    }
    confidence_loss = torch.stack(confidence_losses).mean()
    log_values["confidence"] = float(confidence_loss.detach())
    return torch.stack(losses).mean() + options.trust_share * confidence_loss, log_values


def alignment_levels(
    maps: Sequence[tuple[Tensor, Tensor]], strides: Sequence[int], batch: PairBatch
) -> list[Level]:
    """Return the levels that align images b to the points of images a.

    Args:
        maps: features (2B, C, h, w) and confidences (2B, 1, h, w) of both halves of the batch.
        strides: strides of the levels.
        batch: the B pairs.
    """
    levels = []
    for stride, (features, confidence) in zip(strides, maps, strict=True):
        a, b = features.float().chunk(2)
        reference_confidence, query_confidence = confidence.float().chunk(2)
        cells = batch.xy_a / stride
        levels.append(
            Level(
                functional.normalize(b, dim=1),
                stride,
                functional.normalize(sample(a, cells), dim=-1),
                query_confidence,
                sample(reference_confidence, cells)[..., 0],
            )
        )
    return levels


def unroll_alignment(
    levels: Sequence[Level],
    batch: PairBatch,
    damping: Iterable[nn.Module],
) -> tuple[Pose, ...]:
    """Align images b to images a in a fixed number of steps.

    Returns:
        The poses ``b_from_a`` after each level, differentiable in features and damping.
    """
    factors = [each() for each in damping]
    inputs = batch.points, batch.intrinsics_b, batch.start
    options = Options(iterations=_ITERATIONS, adaptive_damping=False)
    return align(Problem(levels, *inputs, factors, options, batch.valid)).level_poses


def median_pixel_errors(
    errors: Sequence[Tensor], strides: Sequence[int], batch: PairBatch
) -> dict[str, float]:
    """Return the median errors in pixels, at the start and after each level, for the log.

    Args:
        errors: reprojection errors after each level, as ``pose_loss`` returns them.
        strides: strides of the levels.
        batch: the pairs.
    """
    start = reprojection_error(batch.start, batch.b_from_a, *points_in_b(batch))
    named = zip(("start", *strides), (start, *errors), strict=True)
    return {f"pixels/{name}": float(convert_to_pixels(error.median())) for name, error in named}


def filters_and_damping(
    network: nn.Module, damping: nn.Module, rate: float
) -> list[dict[str, Any]]:
    """Return the parameter groups of a network and of its damping, which learns faster.

    Args:
        network: the network, with its damping.
        damping: the damping of its levels.
        rate: learning rate of the filters.
    """
    fast = list(damping.parameters())
    damping_parameters = set(fast)
    filters = [p for p in network.parameters() if p not in damping_parameters]
    slow = {"params": filters, "lr": rate}
    return [slow, {"params": fast, "lr": _DAMPING_RATE * rate, "weight_decay": 0}]
