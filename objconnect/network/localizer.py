"""The localizer ``objconnect``: alignment of the object-connect network's features."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from pydantic import Field

from objconnect.learning.checkpoint import shipped_path
from objconnect.learning.inference import fuse_layers
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.localization.featuremetric.options import SearchingConfig
from objconnect.network.finder import ObjectSearch, ObjectSearchOptions
from objconnect.network.network import read_network
from objconnect.scene.runtime.device import torch_device

SHIPPED: Final = Path(__file__).with_name("objconnect.safetensors")
"""The shipped weights."""


class ObjConnectConfig(SearchingConfig):
    """Options of the objconnect localizer."""

    objects: ObjectSearchOptions | None = Field(
        ObjectSearchOptions(),
        description="Search by objects for images without position or heading; None for none.",
    )


class ObjConnectLocalizer(FeaturemetricLocalizer):
    """The localizer ``objconnect``.

    Raises:
        InputError: the weights are missing or not of this network.
    """

    def __init__(self, config: ObjConnectConfig) -> None:
        network, digest = read_network(config.weights or shipped_path(SHIPPED))
        network.to(torch_device(config.device))
        fuse_layers(network, config.precision)
        objects = None
        if config.objects is not None and network.constellation is not None:
            extract = MapExtractor(network, config.longest, config.precision)
            objects = ObjectSearch(network, extract, config.objects)
        super().__init__("objconnect", network, digest, config, objects)
