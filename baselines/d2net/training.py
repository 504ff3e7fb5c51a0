"""Training of D2-Net."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor, nn

import objconnect.learning.pixloc_net as pixloc
from baselines.d2net.loss import ImagePoints, TripletLoss, triplet_loss
from baselines.d2net.network import STRIDE, D2Net, D2NetNetConfig, read_network, soft_scores
from objconnect.learning.checkpoint import read_weights
from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.contrastive import contrastive_loss, mean_over
from objconnect.learning.training.pairs import PairBatch
from objconnect.learning.vgg import IMAGENET_STD
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError

# Least number of correspondences of a pair in the triplet loss.
_MIN_POINTS: Final = 128


class D2NetTraining:
    """Implements ``objconnect.learning.training.loop.Trainable``.

    The authors start from VGG16 trained on ImageNet and fine-tune its last layer. Here all layers
    are trained, from random weights or from PixLoc's encoder, and a contrastive loss is added. At
    first it is the only loss, because with hardest negatives an untrained network learns to make
    all descriptors equal. It then remains, because the triplet loss accepts errors of four cells.
    """

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        if config.weights is None:
            values = {"width": config.width, **config.network}
            self.network = D2Net(load_config(D2NetNetConfig, None, values))
        elif config.network:
            raise InputError("weights determine the options of their network: leave out 'network'")
        else:
            self.network = start_from(config.weights)
        self.network_config = self.network.config
        self._warm_up = config.warm_up

    def groups(self, rate: float) -> list[dict[str, Any]]:
        """Return all parameters with the same learning rate."""
        return [{"params": list(self.network.parameters()), "lr": rate}]

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        """Return the contrastive loss, plus the mean triplet loss after the warm-up.

        The triplet loss is the mean over the pairs with at least 128 correspondences, as in the
        authors' training, or half of the points of a pair if that is less.

        Returns:
            The loss, and log values: ``contrastive``; after the warm-up also ``pairs``, the number
            of pairs with enough correspondences, and if there are any, the fields of
            ``TripletLoss``.
        """
        count, most_points = batch.valid.shape
        images = torch.cat([batch.image_a, batch.image_b])
        images = images.to(memory_format=torch.channels_last)
        with torch.autocast(images.device.type, torch.bfloat16):
            features = self.network(images)
        features = features.float()
        a, b = features.chunk(2)
        inside = _lie_inside(batch.xy_a, batch.image_a) & _lie_inside(batch.xy_b, batch.image_b)
        valid = batch.valid & inside
        cells = batch.xy_a / STRIDE, batch.xy_b / STRIDE
        losses = contrastive_loss(a, b, *cells, valid)
        contrast = mean_over(valid, losses)
        figures = {"contrastive": float(contrast.detach())}
        if progress < self._warm_up:
            return contrast, figures
        scores = soft_scores(features)
        triplets = [
            triplet_loss(
                ImagePoints(features[i], scores[i], cells[0][i, valid[i]]),
                ImagePoints(features[count + i], scores[count + i], cells[1][i, valid[i]]),
            )
            for i in range(count)
            if int(valid[i].sum()) >= min(_MIN_POINTS, most_points // 2)
        ]
        if not triplets:
            return contrast, {**figures, "pairs": 0.0}
        means = TripletLoss(*(torch.stack(column).mean() for column in zip(*triplets, strict=True)))
        figures |= {name: float(value.detach()) for name, value in means._asdict().items()}
        return contrast + means.loss, {**figures, "pairs": float(len(triplets))}


def start_from(path: Path) -> D2Net:
    """Return a network for training, initialised from D2-Net's weights or PixLoc's encoder.

    Raises:
        InputError: the file does not exist, or its weights belong to neither network.
    """
    tensors = read_weights(path).tensors
    if not any(name.startswith("encoder.") for name in tensors):
        return read_network(path)[0].requires_grad_(True)
    pixloc_network, _ = pixloc.read_network(path)
    network = D2Net(D2NetNetConfig(width=pixloc_network.config.width))
    encoder = [layer for layer in pixloc_network.encoder.modules() if isinstance(layer, nn.Conv2d)]
    layers = [layer for layer in network.modules() if isinstance(layer, nn.Conv2d)]
    with torch.no_grad():
        for layer, pixloc_layer in zip(layers, encoder, strict=False):
            layer.load_state_dict(pixloc_layer.state_dict())
        # PixLoc's input is RGB divided by its standard deviation. D2-Net's input is BGR in 0..255.
        deviation = torch.tensor(IMAGENET_STD).view(1, 3, 1, 1) * 255
        layers[0].weight.copy_((encoder[0].weight / deviation).flip(1))
    return network


def _lie_inside(xy: Tensor, images: Tensor) -> Tensor:
    """Return whether pixels (B, N, 2) are inside images, (B, N); NaN is not."""
    size = xy.new_tensor([images.shape[3], images.shape[2]])
    return ((xy >= 0) & (xy <= size)).all(-1)
