"""Training of the object detector on a frozen network."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from objconnect.learning.checkpoint import shipped_path
from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.pairs import PairBatch
from objconnect.localization.featuremetric.training import half_precision, stack_images
from objconnect.network.config import DetectorConfig
from objconnect.network.detector import DetectorMaps
from objconnect.network.localizer import SHIPPED
from objconnect.network.network import start_from
from objconnect.network.object_loss import IDENTITY_SHARE, geometry_loss, identity_loss
from objconnect.scene.errors import InputError


class ObjectTraining:
    """Implements ``objconnect.learning.training.loop.Trainable`` for the object detector.

    ``TrainConfig.weights`` is a file of the network whose features the detector sees, by default
    the shipped one. These weights do not change, so that the alignment does not change.
    """

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        settings = {"detector": DetectorConfig().model_dump(), "constellation": None}
        settings |= config.network
        self.network = start_from(config.weights or shipped_path(SHIPPED), settings)
        _require_objects(config)
        self.network_config = self.network.config
        if self.network.detector is None:
            raise InputError("the network has no detector: leave network.detector at its default")
        self._detector = self.network.detector
        self.network.requires_grad_(False)
        self._detector.requires_grad_(True)

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        """See ``Trainable``."""
        # In training mode, the running means of the network's batch normalisation would change.
        self.network.eval()
        with half_precision(batch):
            with torch.no_grad():
                levels = self.network(stack_images(batch))
            maps = self._detector(levels)
        maps = DetectorMaps(each.float() for each in maps)
        stride = self._detector.config.stride
        loss, logged = geometry_loss(maps, batch.objects, stride)
        identity, top1_accuracy = identity_loss(maps, batch.objects, stride)
        logged |= {"identity": float(identity.detach()), "top-1 accuracy": top1_accuracy}
        return loss + IDENTITY_SHARE * identity, logged

    def groups(self, rate: float) -> list[dict[str, Any]]:
        """See ``Trainable``."""
        return [{"params": list(self._detector.parameters()), "lr": rate}]


def _require_objects(config: TrainConfig) -> None:
    """Refuse a configuration that makes pairs without objects.

    Raises:
        InputError: pairs of scenes are configured without objects, or pairs are made of
            photographs.
    """
    if not config.pairs.objects:
        raise InputError(
            "the detector learns from pairs with objects: give --set pairs.objects=true, or "
            "--config train/objects-detector"
        )
    if config.photographs and config.photograph_share > 0:
        raise InputError(
            "pairs made of photographs have no objects: leave photographs out, or give --set "
            "photograph_share=0"
        )
