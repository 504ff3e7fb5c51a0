"""Training of the object-connect network."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.pairs import PairBatch
from objconnect.localization.featuremetric.training import (
    alignment_levels,
    contrastive_and_confidence_loss,
    filters_and_damping,
    half_precision,
    median_pixel_errors,
    stack_images,
    unroll_alignment,
)
from objconnect.network.config import ObjConnectNetConfig
from objconnect.network.loss import (
    feature_distance,
    measure_correspondence,
    object_confidence_loss,
    pose_distance,
    total,
)
from objconnect.network.network import ObjConnectNet, start_from
from objconnect.network.objects import Objects
from objconnect.network.segmentation import sample_pixels
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError


class ObjConnectTraining:
    """Trains the network like PixLoc, with the distance of features (equation 7) in addition.

    Implements ``objconnect.learning.training.loop.Trainable``.

    ``TrainConfig.network`` holds fields of ``ObjConnectNetConfig``. ``TrainConfig.weights`` may be
    weights of this network, even if made with other values of these fields, or of PixLoc.
    """

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        if config.weights is None:
            settings = {"width": config.width, **config.network}
            self.network = ObjConnectNet(load_config(ObjConnectNetConfig, None, settings))
        else:
            self.network = start_from(config.weights, config.network)
        self.network_config = self.network.config
        if self.network_config.segmentation == "given":
            raise InputError(
                "network.segmentation is 'given', but training pairs have no label maps: train "
                "with 'slic'; label maps can be given to the trained network"
            )
        self._warm_up, self._losses = config.warm_up, config.losses

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        """See ``Trainable``."""
        strides = self.network_config.strides
        images = stack_images(batch)
        labels = self._segments(images)
        with half_precision(batch):
            maps, objects = self.network.describe(images, labels)
        contrast, figures = contrastive_and_confidence_loss(maps, strides, batch, self._losses)
        levels = alignment_levels(maps, strides, batch)
        distance = feature_distance(levels, batch)
        figures["features"] = float(distance.detach())
        poses = None
        if progress >= self._warm_up:
            level_poses = unroll_alignment(levels, batch, self.network.damping)
            poses, errors = pose_distance(level_poses, strides, batch)
            figures |= median_pixel_errors(errors, strides, batch)
        loss = total(contrast, distance, poses, self._losses)
        if objects is not None and labels is not None:
            confidence_loss = self._confidence_loss(objects, labels, batch)
            figures["trust"] = float(confidence_loss.detach())
            loss = loss + confidence_loss
        if self.network.training:
            figures |= self.network.residuals()
        return loss, figures

    def groups(self, rate: float) -> list[dict[str, Any]]:
        """See ``Trainable``."""
        return filters_and_damping(self.network, self.network.damping, rate)

    def _segments(self, images: Tensor) -> Tensor | None:
        has_no_objects = self.network_config.segmentation == "none"
        return None if has_no_objects else self.network.segments(images)

    def _confidence_loss(self, objects: Objects, labels: Tensor, batch: PairBatch) -> Tensor:
        """Return the loss of the confidences of the objects of both images of each pair."""
        a, b = labels.chunk(2)
        points_a = sample_pixels(a, batch.image_a, batch.xy_a)
        points_b = sample_pixels(b, batch.image_b, batch.xy_b)
        count = self.network_config.segments
        a_in_b = measure_correspondence(points_a, points_b, batch.valid, count)
        b_in_a = measure_correspondence(points_b, points_a, batch.valid, count)
        target, has_target = (torch.cat(pair) for pair in zip(a_in_b, b_in_a, strict=True))
        return object_confidence_loss(objects.confidence, target, has_target & objects.present)
