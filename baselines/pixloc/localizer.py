"""The localizers ``pixloc`` and ``pixloc-search``, which align the features of PixLoc's network."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from objconnect.learning.checkpoint import shipped_path
from objconnect.learning.inference import fuse_layers
from objconnect.learning.pixloc_net import read_network
from objconnect.localization.featuremetric.corners import CornerOptions
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.featuremetric.options import FeaturemetricConfig, SearchingConfig
from objconnect.scene.config import with_default
from objconnect.scene.runtime.device import torch_device

SHIPPED: Final = Path(__file__).with_name("pixloc.safetensors")
"""The shipped weights."""


class PixlocConfig(FeaturemetricConfig):
    """Options of the pixloc localizer, which aligns to the map's points only, as its authors do.

    ``weights`` may be a checkpoint of the authors.
    """

    corners: CornerOptions | None = with_default(FeaturemetricConfig, "corners", None)


class PixlocLocalizer(FeaturemetricLocalizer):
    """The localizer ``pixloc``.

    Raises:
        InputError: the weights are missing or belong to another network.
    """

    def __init__(self, config: FeaturemetricConfig, name: str = "pixloc") -> None:
        network, digest = read_network(config.weights or shipped_path(SHIPPED))
        network.to(torch_device(config.device))
        fuse_layers(network, config.precision)
        super().__init__(name, network, digest, config)


class PixlocSearchConfig(SearchingConfig):
    """Options of the pixloc-search localizer: the options of ``objconnect`` without objects.

    It separates two causes in comparisons. Its gain over ``pixloc`` comes from SIFT matches, the
    search of the whole map, image corners used as additional points, and more reference images. The
    gain of ``objconnect`` over it comes from the network and objects.
    """


class PixlocSearchLocalizer(PixlocLocalizer):
    """The localizer ``pixloc-search``; see ``PixlocSearchConfig``."""

    def __init__(self, config: PixlocSearchConfig) -> None:
        super().__init__(config, "pixloc-search")
