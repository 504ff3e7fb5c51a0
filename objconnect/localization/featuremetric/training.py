"""Training of networks with features for alignment: contrastive loss and unrolled poses."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from objconnect.learning.training.contrastive import contrastive, mean_over, sample
from objconnect.learning.training.options import LOSSES, LossOptions
from objconnect.learning.training.pairs import PairBatch
from objconnect.learning.training.pose_loss import Seen, in_pixels, reprojection_error
from objconnect.localization.align.aligner import align
from objconnect.localization.align.options import Options
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import Level
from objconnect.scene.geometry.pose import Pose

# Numerical guard of the logarithm.
_LEAST_TRUST: Final = 1e-3
# Unrolled iterations of the alignment per level, for the pose loss.
_ITERATIONS: Final = 8
# Learning rate of the damping relative to the filters'. It is large because a factor is shared by
# all pixels.
_DAMPING_RATE: Final = 30.0


def half_precision(batch: PairBatch) -> torch.autocast:
    """Return the bfloat16 context for the network; losses and alignment run outside of it."""
    return torch.autocast(batch.image_a.device.type, torch.bfloat16)


def stack_images(batch: PairBatch) -> Tensor:
    """Return the images a, then the images b, (2B, 3, S, S), channels-last in memory."""
    images = torch.cat([batch.image_a, batch.image_b])
    return images.to(memory_format=torch.channels_last)


def view_of_b(batch: PairBatch) -> Seen:
    """Return the points of a batch in the view of the cameras b."""
    return Seen(batch.points, batch.intrinsics_b, batch.valid)


def contrast_of(
    maps: Sequence[tuple[Tensor, Tensor]],
    strides: Sequence[int],
    batch: PairBatch,
    options: LossOptions = LOSSES,
) -> tuple[Tensor, dict[str, float]]:
    """Return the contrastive loss plus that of the confidence, means over levels, and log values.

    The confidence is trained to predict, from one image, the probability that a point is matched.
    Points that snow or another hour changes then have small weights. If the confidence is trained
    by the pose loss alone, as in PixLoc, it stays uniform for a long time.

    Args:
        maps: features and confidences of both halves of the batch, level by level.
        strides: strides of the levels.
        batch: the pairs.
        options: weights of the losses.
    """
    losses, doubts = [], []
    for stride, (features, confidence) in zip(strides, maps, strict=True):
        a, b = features.float().chunk(2)
        cells = batch.xy_a / stride, batch.xy_b / stride
        lost = contrastive(a, b, *cells, batch.valid)
        losses.append(mean_over(batch.valid, lost))
        likely = torch.exp(-lost.detach())
        for half, places in zip(confidence.chunk(2), cells, strict=True):
            said = sample(half, places)[..., 0].clamp(_LEAST_TRUST, 1 - _LEAST_TRUST)
            doubt = functional.binary_cross_entropy(said, likely, reduction="none")
            doubts.append(mean_over(batch.valid, doubt))
    figures = {
        f"contrastive/{stride}": float(loss.detach())
        for stride, loss in zip(strides, losses, strict=True)
    }
    doubt = torch.stack(doubts).mean()
    figures["confidence"] = float(doubt.detach())
    return torch.stack(losses).mean() + options.trust_share * doubt, figures


def levels_of(
    maps: Sequence[tuple[Tensor, Tensor]], strides: Sequence[int], batch: PairBatch
) -> list[Level]:
    """Return the levels that align images b to the points of images a."""
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


def unroll(
    levels: Sequence[Level],
    batch: PairBatch,
    damping: Iterable[nn.Module],
) -> tuple[Pose, ...]:
    """Return the poses after each level, differentiable in features and damping."""
    factors = [each() for each in damping]
    place = batch.points, batch.intrinsics_b, batch.start
    options = Options(iterations=_ITERATIONS, careful=False)
    return align(Problem(levels, *place, factors, options, batch.valid)).by_level


def pixels_of(
    errors: Sequence[Tensor], strides: Sequence[int], batch: PairBatch
) -> dict[str, float]:
    """Return the median errors in pixels, at the start and after each level, for the log."""
    start = reprojection_error(batch.start, batch.b_from_a, *view_of_b(batch))
    named = zip(("start", *strides), (start, *errors), strict=True)
    return {f"pixels/{name}": float(in_pixels(error.median())) for name, error in named}


def filters_and_damping(
    network: nn.Module, damping: nn.Module, rate: float
) -> list[dict[str, Any]]:
    """Return the parameter groups of a network and its damping, which has a larger rate."""
    fast = list(damping.parameters())
    known = set(fast)
    filters = [p for p in network.parameters() if p not in known]
    slow = {"params": filters, "lr": rate}
    return [slow, {"params": fast, "lr": _DAMPING_RATE * rate, "weight_decay": 0}]
