"""D2-Net as what the training loop trains."""

from __future__ import annotations

from typing import Any, Final

import torch
from torch import Tensor

from baselines.d2net.loss import TripletLoss, triplet_loss
from baselines.d2net.network import STRIDE, D2Net, D2NetNetConfig, read_network, soft_scores
from baselines.training.config import TrainConfig
from baselines.training.contrastive import contrastive
from baselines.training.pairs import PairBatch
from scene.config import load_config
from scene.errors import InputError

# Correspondences without which the authors pass over a pair of images.
_LEAST: Final = 128


class D2NetTraining:
    """Implements ``baselines.training.loop.Trainable``.

    The authors begin with VGG16 as trained on ImageNet and tune its last layer. From nothing, all
    layers learn, and first by a contrastive loss: the hardest negative of a network that knows
    nothing teaches it to make all descriptors equal.
    """

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        if config.weights is None:
            made = {"width": config.width, **config.network}
            self.network = D2Net(load_config(D2NetNetConfig, None, made))
        elif config.network:
            raise InputError("weights come with what their network is made of: leave out 'network'")
        else:
            self.network, _ = read_network(config.weights)
            self.network.requires_grad_(True)
        self.network_config = self.network.config
        self._warm_up = config.warm_up

    def groups(self, rate: float) -> list[dict[str, Any]]:
        """All parameters alike."""
        return [{"params": list(self.network.parameters()), "lr": rate}]

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        """Contrastive, then the mean triplet loss over the pairs with enough correspondences.

        Enough are 128, or half of what the batch has room for if that is less.

        Returns:
            the loss, zero where no pair has enough, and figures: the fields of ``TripletLoss``
            where one has, and ``pairs`` that have.
        """
        count, room = batch.valid.shape
        images = torch.cat([batch.image_a, batch.image_b])
        images = images.to(memory_format=torch.channels_last)
        with torch.autocast(images.device.type, torch.bfloat16):
            features = self.network(images)
        features = features.float()
        if progress < self._warm_up:
            a, b = features.chunk(2)
            loss = contrastive(a, b, batch.xy_a / STRIDE, batch.xy_b / STRIDE, batch.valid)
            return loss, {"contrastive": float(loss.detach())}
        scores = soft_scores(features)
        inside = _inside(batch.xy_a, batch.image_a) & _inside(batch.xy_b, batch.image_b)
        valid = batch.valid & inside
        found = [
            triplet_loss(
                features[i],
                scores[i],
                features[count + i],
                scores[count + i],
                batch.xy_a[i, valid[i]] / STRIDE,
                batch.xy_b[i, valid[i]] / STRIDE,
            )
            for i in range(count)
            if int(valid[i].sum()) >= min(_LEAST, room // 2)
        ]
        if not found:
            return features.sum() * 0, {"pairs": 0.0}
        means = TripletLoss(*(torch.stack(column).mean() for column in zip(*found, strict=True)))
        figures = {name: float(value.detach()) for name, value in means._asdict().items()}
        return means.loss, {**figures, "pairs": float(len(found))}


def _inside(xy: Tensor, images: Tensor) -> Tensor:
    """Which pixels (B, N, 2) lie in images, (B, N); NaN does not."""
    size = xy.new_tensor([images.shape[3], images.shape[2]])
    return ((xy >= 0) & (xy <= size)).all(-1)
