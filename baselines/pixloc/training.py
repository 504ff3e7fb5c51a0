"""What PixLoc learns from a batch of pairs: features that tell places apart, then poses with them.

The authors train by the pose alone, from weights of ImageNet. From nothing that leaves the coarse
level weak, so that a contrastive loss comes first and stays beside it.
"""

from __future__ import annotations

from typing import Any, Final

import torch
from torch import Tensor
from torch.nn import functional

from baselines.align.aligner import align
from baselines.align.descent import Options
from baselines.align.residuals import Level
from baselines.pixloc.loss import pose_loss, reprojection_error
from baselines.pixloc.network import PixlocNet, PixlocNetConfig, read_network
from baselines.training.config import TrainConfig
from baselines.training.contrastive import contrastive, sample
from baselines.training.pairs import PairBatch

# The authors' finest level is every pixel. Every other costs a third of it in training, and the
# precision lost is below that of a map's points.
_STRIDES: Final = (16, 4, 2)
_UNROLLED: Final = Options(iterations=6, careful=False)
# Pixels against nats: at the end both are about one.
_POSE_SHARE: Final = 0.3
# Damping is one number for all pixels: it needs larger steps than the filters.
_DAMPING_RATE: Final = 30.0


class PixlocTraining:
    """Implements ``baselines.training.loop.Trainable``."""

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        if config.weights is None:
            self.network = PixlocNet(PixlocNetConfig(width=config.width, strides=_STRIDES))
        else:
            self.network, _ = read_network(config.weights)
        self.network_config = self.network.config
        self._warm_up = config.warm_up

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        """See ``Trainable``."""
        images = torch.cat([batch.image_a, batch.image_b])
        images = images.to(memory_format=torch.channels_last)
        with torch.autocast(images.device.type, torch.bfloat16):
            levels = self.network(images)
        strides = self.network_config.strides
        losses, scales = [], []
        for stride, (features, confidence) in zip(strides, levels, strict=True):
            a, b = features.float().chunk(2)
            cells_a, cells_b = batch.xy_a / stride, batch.xy_b / stride
            losses.append(contrastive(a, b, cells_a, cells_b, batch.valid))
            reference_confidence, query_confidence = confidence.float().chunk(2)
            scales.append(
                Level(
                    functional.normalize(b, dim=1),
                    stride,
                    functional.normalize(sample(a, cells_a), dim=-1),
                    query_confidence,
                    sample(reference_confidence, cells_a)[..., 0],
                )
            )
        figures = {
            f"contrastive/{stride}": float(loss.detach())
            for stride, loss in zip(strides, losses, strict=True)
        }
        loss = torch.stack(losses).mean()
        if progress < self._warm_up:
            return loss, figures
        found = align(
            scales,
            batch.points,
            batch.intrinsics_b,
            batch.start,
            [damping() for damping in self.network.damping],
            _UNROLLED,
            batch.valid,
        )
        place = batch.points, batch.intrinsics_b, batch.valid
        pose_error, errors = pose_loss(found.by_level, strides, batch.b_from_a, *place)
        start = reprojection_error(batch.start, batch.b_from_a, *place)
        figures["pixels/start"] = float(start.median())
        for stride, error in zip(strides, errors, strict=True):
            figures[f"pixels/{stride}"] = float(error.median())
        return loss + _POSE_SHARE * pose_error, figures

    def groups(self, rate: float) -> list[dict[str, Any]]:
        """See ``Trainable``."""
        damping = set(self.network.damping.parameters())
        filters = [p for p in self.network.parameters() if p not in damping]
        slow = {"params": filters, "lr": rate}
        return [slow, {"params": list(damping), "lr": rate * _DAMPING_RATE, "weight_decay": 0}]
