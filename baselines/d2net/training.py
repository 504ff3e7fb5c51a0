"""D2-Net as what the training loop trains."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor, nn

import baselines.pixloc.network as pixloc
from baselines.checkpoint import read_weights
from baselines.d2net.loss import TripletLoss, triplet_loss
from baselines.d2net.network import STRIDE, D2Net, D2NetNetConfig, read_network, soft_scores
from baselines.training.config import TrainConfig
from baselines.training.contrastive import contrastive, mean_over
from baselines.training.pairs import PairBatch
from baselines.vgg import IMAGENET_STD
from scene.config import load_config
from scene.errors import InputError

# Correspondences without which the authors pass over a pair of images.
_LEAST: Final = 128


class D2NetTraining:
    """Implements ``baselines.training.loop.Trainable``.

    The authors begin with VGG16 as trained on ImageNet and tune its last layer. Here all layers
    learn, from nothing or from PixLoc's encoder, and by a contrastive loss too. It comes first, for
    the hardest negative of a network that knows nothing teaches it to make all descriptors equal;
    and it stays, for the triplets do not ask for a place more exact than four cells.
    """

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        if config.weights is None:
            made = {"width": config.width, **config.network}
            self.network = D2Net(load_config(D2NetNetConfig, None, made))
        elif config.network:
            raise InputError("weights come with what their network is made of: leave out 'network'")
        else:
            self.network = start_from(config.weights)
        self.network_config = self.network.config
        self._warm_up = config.warm_up

    def groups(self, rate: float) -> list[dict[str, Any]]:
        """All parameters alike."""
        return [{"params": list(self.network.parameters()), "lr": rate}]

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        """Contrastive, then also the mean triplet loss over pairs with enough correspondences.

        Enough are 128, or half of what the batch has room for if that is less.

        Returns:
            the loss and figures: ``contrastive``, the fields of ``TripletLoss`` where a pair has
            enough, and ``pairs`` that have.
        """
        count, room = batch.valid.shape
        images = torch.cat([batch.image_a, batch.image_b])
        images = images.to(memory_format=torch.channels_last)
        with torch.autocast(images.device.type, torch.bfloat16):
            features = self.network(images)
        features = features.float()
        a, b = features.chunk(2)
        inside = _inside(batch.xy_a, batch.image_a) & _inside(batch.xy_b, batch.image_b)
        valid = batch.valid & inside
        lost = contrastive(a, b, batch.xy_a / STRIDE, batch.xy_b / STRIDE, valid)
        contrast = mean_over(valid, lost)
        figures = {"contrastive": float(contrast.detach())}
        if progress < self._warm_up:
            return contrast, figures
        scores = soft_scores(features)
        triplets = [
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
        if not triplets:
            return contrast, {**figures, "pairs": 0.0}
        means = TripletLoss(*(torch.stack(column).mean() for column in zip(*triplets, strict=True)))
        figures |= {name: float(value.detach()) for name, value in means._asdict().items()}
        return contrast + means.loss, {**figures, "pairs": float(len(triplets))}


def start_from(path: Path) -> D2Net:
    """A network that goes on from weights, to be trained: its own, or PixLoc's encoder.

    Raises:
        InputError: there is no such file, or it is of neither network.
    """
    tensors = read_weights(path).tensors
    if not any(name.startswith("encoder.") for name in tensors):
        return read_network(path)[0].requires_grad_(True)
    peer, _ = pixloc.read_network(path)
    network = D2Net(D2NetNetConfig(width=peer.config.width))
    theirs = [layer for layer in peer.encoder.modules() if isinstance(layer, nn.Conv2d)]
    ours = [layer for layer in network.modules() if isinstance(layer, nn.Conv2d)]
    with torch.no_grad():
        for mine, other in zip(ours, theirs, strict=False):
            mine.load_state_dict(other.state_dict())
        # They see red, green and blue in units of their spread, we blue, green and red in 0..255.
        spread = torch.tensor(IMAGENET_STD).view(1, 3, 1, 1) * 255
        ours[0].weight.copy_((theirs[0].weight / spread).flip(1))
    return network


def _inside(xy: Tensor, images: Tensor) -> Tensor:
    """Which pixels (B, N, 2) lie in images, (B, N); NaN does not."""
    size = xy.new_tensor([images.shape[3], images.shape[2]])
    return ((xy >= 0) & (xy <= size)).all(-1)
