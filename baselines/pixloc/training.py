"""What PixLoc learns from a batch of pairs: features that tell places apart, then poses with them.

The authors train by the pose alone, from weights of ImageNet. From nothing that leaves the coarse
level weak, so that a contrastive loss comes first and stays beside it.
"""

from __future__ import annotations

from typing import Any, Final

import torch
from torch import Tensor

from baselines.pixloc.network import PixlocNet, PixlocNetConfig, read_network
from baselines.training.config import TrainConfig
from baselines.training.contrastive import contrastive
from baselines.training.pairs import PairBatch

# The authors' finest level is every pixel. Every other costs a third of it in training, and the
# precision lost is below that of a map's points.
_STRIDES: Final = (16, 4, 2)
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
        losses = []
        for stride, (features, _) in zip(self.network_config.strides, levels, strict=True):
            a, b = features.float().chunk(2)
            cells = batch.xy_a / stride, batch.xy_b / stride
            losses.append(contrastive(a, b, *cells, batch.valid))
        figures = {
            f"contrastive/{stride}": float(loss.detach())
            for stride, loss in zip(self.network_config.strides, losses, strict=True)
        }
        return torch.stack(losses).mean(), figures

    def groups(self, rate: float) -> list[dict[str, Any]]:
        """See ``Trainable``."""
        filters = [p for name, p in self.network.named_parameters() if name != "damping"]
        damping = {"params": [self.network.damping], "lr": rate * _DAMPING_RATE, "weight_decay": 0}
        return [{"params": filters, "lr": rate}, damping]
