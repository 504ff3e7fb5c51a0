"""Training of the object-connect network."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.pairs import PairBatch
from objconnect.localization.featuremetric.training import (
    contrast_of,
    filters_and_damping,
    half_precision,
    levels_of,
    pixels_of,
    stack_images,
    unroll,
)
from objconnect.network.config import ObjConnectNetConfig
from objconnect.network.loss import (
    feature_distance,
    measure_correspondence,
    pose_distance,
    total,
    trust_loss,
)
from objconnect.network.network import ObjConnectNet, start_from
from objconnect.network.objects import Objects
from objconnect.network.segmentation import at_pixels
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError


class ObjConnectTraining:
    """Implements ``Trainable``: PixLoc's training with equation (7) added.

    ``TrainConfig.network`` takes the switches of ``ObjConnectNetConfig``. ``TrainConfig.weights``
    may be weights of this network, also with other switches, or weights of PixLoc.
    """

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        if config.weights is None:
            made = {"width": config.width, **config.network}
            self.network = ObjConnectNet(load_config(ObjConnectNetConfig, None, made))
        else:
            self.network = start_from(config.weights, config.network)
        self.network_config = self.network.config
        if self.network_config.segmentation == "given":
            raise InputError("pairs come without masks: train with slic, then give masks")
        self._warm_up, self._losses = config.warm_up, config.losses

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        """See ``Trainable``."""
        strides = self.network_config.strides
        images = stack_images(batch)
        labels = self._segments(images)
        with half_precision(batch):
            maps, objects = self.network.describe(images, labels)
        contrast, figures = contrast_of(maps, strides, batch, self._losses)
        levels = levels_of(maps, strides, batch)
        distance = feature_distance(levels, batch)
        figures["features"] = float(distance.detach())
        poses = None
        if progress >= self._warm_up:
            by_level = unroll(levels, batch, self.network.damping)
            poses, errors = pose_distance(by_level, strides, batch)
            figures |= pixels_of(errors, strides, batch)
        loss = total(contrast, distance, poses, self._losses)
        if objects is not None and labels is not None:
            trust = self._trust(objects, labels, batch)
            figures["trust"] = float(trust.detach())
            loss = loss + trust
        if self.network.training:
            figures |= self.network.residuals()
        return loss, figures

    def groups(self, rate: float) -> list[dict[str, Any]]:
        """See ``Trainable``."""
        return filters_and_damping(self.network, self.network.damping, rate)

    def _segments(self, images: Tensor) -> Tensor | None:
        none = self.network_config.segmentation == "none"
        return None if none else self.network.segments(images)

    def _trust(self, objects: Objects, labels: Tensor, batch: PairBatch) -> Tensor:
        a, b = labels.chunk(2)
        points_a = at_pixels(a, batch.image_a, batch.xy_a)
        points_b = at_pixels(b, batch.image_b, batch.xy_b)
        count = self.network_config.segments
        there = measure_correspondence(points_a, points_b, batch.valid, count)
        back = measure_correspondence(points_b, points_a, batch.valid, count)
        kept, counts = (torch.cat(pair) for pair in zip(there, back, strict=True))
        return trust_loss(objects.confidence, kept, counts & objects.present)
