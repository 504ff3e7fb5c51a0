"""PixLoc for the training loop. Features are trained to distinguish places, then to give poses.

The authors train by the pose loss alone, from weights of ImageNet. From random weights, this leaves
the coarse level weak. Therefore a contrastive loss comes first, and remains when the pose loss is
added.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.align.aligner import align
from baselines.align.options import Options
from baselines.align.problem import Problem
from baselines.align.residuals import Level
from baselines.pixloc.loss import Seen, in_pixels, pose_loss, reprojection_error
from baselines.pixloc.network import PixlocNet, PixlocNetConfig, read_network
from baselines.training.config import TrainConfig
from baselines.training.contrastive import contrastive, mean_over, sample
from baselines.training.options import LOSSES, LossOptions
from baselines.training.pairs import PairBatch
from scene.config import load_config
from scene.errors import InputError
from scene.geometry.pose import Pose

# The authors' finest stride is 1. Stride 2 takes a third of the time in training, and the loss of
# precision is below the error of a map's points. Weights record the strides of their training.
_STRIDES: Final = (16, 4, 2)
# Numerical guard of the logarithm.
_LEAST_TRUST: Final = 1e-3


class PixlocTraining:
    """Implements ``baselines.training.loop.Trainable``."""

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        if config.weights is None:
            made = {"width": config.width, "strides": _STRIDES, **config.network}
            self.network = PixlocNet(load_config(PixlocNetConfig, None, made))
        elif config.network:
            raise InputError("weights come with what their network is made of: leave out 'network'")
        else:
            self.network, _ = read_network(config.weights)
        self.network_config = self.network.config
        self._warm_up, self._losses = config.warm_up, config.losses

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        """See ``Trainable``."""
        strides = self.network_config.strides
        with half_precision(batch):
            maps = self.network(both(batch))
        contrast, figures = contrast_of(maps, strides, batch, self._losses)
        if progress < self._warm_up:
            return contrast, figures
        levels = levels_of(maps, strides, batch)
        by_level = unrolled(levels, batch, self.network.damping, self._losses.iterations)
        pose_error, errors = pose_loss(
            by_level, strides, batch.b_from_a, seen_by_b(batch), self._losses
        )
        figures |= pixels_of(errors, strides, batch)
        return contrast + self._losses.pose_share * pose_error, figures

    def groups(self, rate: float) -> list[dict[str, Any]]:
        """See ``Trainable``."""
        faster = rate * self._losses.damping_rate
        return filters_and_damping(self.network, self.network.damping, rate, faster)


def half_precision(batch: PairBatch) -> torch.autocast:
    """Return the context of half precision that networks run in, but not losses and alignment."""
    return torch.autocast(batch.image_a.device.type, torch.bfloat16)


def both(batch: PairBatch) -> Tensor:
    """Return the images a, then the images b, (2B, 3, S, S), in the fastest memory layout."""
    images = torch.cat([batch.image_a, batch.image_b])
    return images.to(memory_format=torch.channels_last)


def seen_by_b(batch: PairBatch) -> Seen:
    """Return the points of a batch in the view of the cameras b."""
    return Seen(batch.points, batch.intrinsics_b, batch.valid)


def contrast_of(
    maps: Sequence[tuple[Tensor, Tensor]],
    strides: Sequence[int],
    batch: PairBatch,
    options: LossOptions = LOSSES,
) -> tuple[Tensor, dict[str, float]]:
    """Return the contrastive loss plus that of the confidence, means over levels, and figures.

    The confidence is trained to predict the probability that a place is matched, from one image of
    it. Places that snow or another hour changes then have small weights. If the confidence is
    trained by the pose loss alone, as the authors do, it stays uniform for a long time.

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
        lost = contrastive(a, b, *cells, batch.valid, options.contrast)
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
    """Return the levels of an alignment of images b to the points of images a."""
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


def unrolled(
    levels: Sequence[Level],
    batch: PairBatch,
    damping: Iterable[nn.Module],
    iterations: int = LOSSES.iterations,
) -> tuple[Pose, ...]:
    """Return the poses after each level, with gradients for features and damping."""
    factors = [each() for each in damping]
    place = batch.points, batch.intrinsics_b, batch.start
    options = Options(iterations=iterations, careful=False)
    return align(Problem(levels, *place, factors, options, batch.valid)).by_level


def pixels_of(
    errors: Sequence[Tensor], strides: Sequence[int], batch: PairBatch
) -> dict[str, float]:
    """Return the median errors in pixels, at the start and after each level, for the log."""
    start = reprojection_error(batch.start, batch.b_from_a, *seen_by_b(batch))
    named = zip(("start", *strides), (start, *errors), strict=True)
    return {f"pixels/{name}": float(in_pixels(error.median())) for name, error in named}


def filters_and_damping(
    network: nn.Module, damping: nn.Module, rate: float, damping_rate: float
) -> list[dict[str, Any]]:
    """Return the groups of parameters of a network and its damping, which has a larger rate."""
    fast = list(damping.parameters())
    known = set(fast)
    filters = [p for p in network.parameters() if p not in known]
    slow = {"params": filters, "lr": rate}
    return [slow, {"params": fast, "lr": damping_rate, "weight_decay": 0}]
