"""What PixLoc learns from a batch of pairs: features that tell places apart, then poses with them.

The authors train by the pose alone, from weights of ImageNet. From nothing that leaves the coarse
level weak, so that a contrastive loss comes first and stays beside it.
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
from baselines.pixloc.loss import in_pixels, pose_loss, reprojection_error
from baselines.pixloc.network import PixlocNet, PixlocNetConfig, read_network
from baselines.training.config import TrainConfig
from baselines.training.contrastive import contrastive, mean_over, sample
from baselines.training.pairs import PairBatch
from scene.config import load_config
from scene.errors import InputError
from scene.geometry.pose import Pose

# The authors' finest level is every pixel. Every other costs a third of it in training, and the
# precision lost is below that of a map's points.
_STRIDES: Final = (16, 4, 2)
_UNROLLED: Final = Options(iterations=8, careful=False)
# Pixels against nats: at the end both are about one.
POSE_SHARE: Final = 0.3
TRUST_SHARE: Final = 0.3
_LEAST_TRUST: Final = 1e-3
# Damping is one number for all pixels: it needs larger steps than the filters.
_DAMPING_RATE: Final = 30.0


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
        self._warm_up = config.warm_up

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        """See ``Trainable``."""
        strides = self.network_config.strides
        with half_precision(batch):
            maps = self.network(both(batch))
        contrast, figures = contrast_of(maps, strides, batch)
        if progress < self._warm_up:
            return contrast, figures
        levels = levels_of(maps, strides, batch)
        by_level = unrolled(levels, batch, self.network.damping)
        place = batch.points, batch.intrinsics_b, batch.valid
        pose_error, errors = pose_loss(by_level, strides, batch.b_from_a, *place)
        figures |= pixels_of(errors, strides, batch)
        return contrast + POSE_SHARE * pose_error, figures

    def groups(self, rate: float) -> list[dict[str, Any]]:
        """See ``Trainable``."""
        return filters_and_damping(self.network, self.network.damping, rate)


def half_precision(batch: PairBatch) -> torch.autocast:
    """Return the context of half precision that networks run in, but not losses and alignment."""
    return torch.autocast(batch.image_a.device.type, torch.bfloat16)


def both(batch: PairBatch) -> Tensor:
    """The images a, then the images b, (2B, 3, S, S), in the layout that is fastest."""
    images = torch.cat([batch.image_a, batch.image_b])
    return images.to(memory_format=torch.channels_last)


def contrast_of(
    maps: Sequence[tuple[Tensor, Tensor]], strides: Sequence[int], batch: PairBatch
) -> tuple[Tensor, dict[str, float]]:
    """The mean over the levels of the contrastive loss and of that of the confidence, and figures.

    Confidence is taught to say how likely a place is found again, from one look at it: what snow or
    another hour hides should count for little. By the pose alone, as the authors teach it, it stays
    the same everywhere for long.

    Args:
        maps: features and confidences of ``both`` halves of the batch, level by level.
        strides: of the levels.
        batch: what is known of the pairs.
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
    return torch.stack(losses).mean() + TRUST_SHARE * doubt, figures


def levels_of(
    maps: Sequence[tuple[Tensor, Tensor]], strides: Sequence[int], batch: PairBatch
) -> list[Level]:
    """The images b as queries, and the points as the images a show them. See ``contrast_of``."""
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
    levels: Sequence[Level], batch: PairBatch, damping: Iterable[nn.Module]
) -> tuple[Pose, ...]:
    """Poses after each level, through which gradients reach features and damping."""
    factors = [each() for each in damping]
    place = batch.points, batch.intrinsics_b, batch.start
    return align(Problem(levels, *place, factors, _UNROLLED, batch.valid)).by_level


def pixels_of(
    errors: Sequence[Tensor], strides: Sequence[int], batch: PairBatch
) -> dict[str, float]:
    """Median errors in pixels, at the start and after each level, to log."""
    place = batch.points, batch.intrinsics_b, batch.valid
    start = reprojection_error(batch.start, batch.b_from_a, *place)
    named = zip(("start", *strides), (start, *errors), strict=True)
    return {f"pixels/{name}": float(in_pixels(error.median())) for name, error in named}


def filters_and_damping(
    network: nn.Module, damping: nn.Module, rate: float
) -> list[dict[str, Any]]:
    """Groups of parameters: of a network, and of the damping in it, which learns faster."""
    fast = list(damping.parameters())
    known = set(fast)
    filters = [p for p in network.parameters() if p not in known]
    slow = {"params": filters, "lr": rate}
    return [slow, {"params": fast, "lr": rate * _DAMPING_RATE, "weight_decay": 0}]
