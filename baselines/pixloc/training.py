"""Training of PixLoc: by a contrastive loss alone at first, then by the pose loss too.

The authors train by the pose loss alone, from weights of ImageNet. From random weights, this leaves
the coarse level weak. The contrastive loss remains when the pose loss is added.
"""

from __future__ import annotations

from typing import Any, Final

import torch
from torch import Tensor

from objconnect.learning.pixloc_net import PixlocNet, PixlocNetConfig, read_network
from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.pairs import PairBatch
from objconnect.learning.training.pose_loss import pose_loss
from objconnect.localization.featuremetric.training import (
    alignment_levels,
    contrastive_and_confidence_loss,
    filters_and_damping,
    half_precision,
    median_pixel_errors,
    points_in_b,
    stack_images,
    unroll_alignment,
)
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError

# The authors' finest stride is 1. Stride 2 trains in a third of the time, and its loss of precision
# is below the error of a map's points. Weights record the strides of their training.
_STRIDES: Final = (16, 4, 2)


class PixlocTraining:
    """Implements ``objconnect.learning.training.loop.Trainable``."""

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        if config.weights is None:
            values = {"width": config.width, "strides": _STRIDES, **config.network}
            self.network = PixlocNet(load_config(PixlocNetConfig, None, values))
        elif config.network:
            raise InputError("weights determine the options of their network: leave out 'network'")
        else:
            self.network, _ = read_network(config.weights)
        self.network_config = self.network.config
        self._warm_up, self._losses = config.warm_up, config.losses

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        """See ``Trainable``."""
        strides = self.network_config.strides
        with half_precision(batch):
            maps = self.network(stack_images(batch))
        contrast, figures = contrastive_and_confidence_loss(maps, strides, batch, self._losses)
        if progress < self._warm_up:
            return contrast, figures
        levels = alignment_levels(maps, strides, batch)
        poses = unroll_alignment(levels, batch, self.network.damping)
        pose_error, errors = pose_loss(poses, strides, batch.b_from_a, points_in_b(batch))
        figures |= median_pixel_errors(errors, strides, batch)
        return contrast + self._losses.pose_share * pose_error, figures

    def groups(self, rate: float) -> list[dict[str, Any]]:
        """See ``Trainable``."""
        return filters_and_damping(self.network, self.network.damping, rate)
