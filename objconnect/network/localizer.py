"""The localizer ``objconnect``: alignment of the object-connect network's features."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, Final

from pydantic import Field

from objconnect.learning.checkpoint import shipped_path
from objconnect.learning.inference import fuse_layers
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.localization.featuremetric.options import SearchingConfig
from objconnect.network.finder import ObjectSearch, ObjectSearchOptions
from objconnect.network.network import ObjConnectNet, read_network
from objconnect.scene.errors import InputError
from objconnect.scene.runtime.device import torch_device

log = logging.getLogger(__name__)

SHIPPED: Final = Path(__file__).with_name("objconnect.safetensors")
"""File of the shipped weights."""


class ObjConnectConfig(SearchingConfig):
    """Options of the objconnect localizer."""

    objects: ObjectSearchOptions | None = Field(
        ObjectSearchOptions(),
        description="Search by objects for images that lack a position, a heading or both; None "
        "for none. It needs ``multistart``, and weights with learned objects; with other weights "
        "the default is None.",
    )

    def _switched_off(self) -> dict[str, Any]:
        return super()._switched_off() | {"objects": None}


class ObjConnectLocalizer(FeaturemetricLocalizer):
    """The localizer ``objconnect``.

    Attributes:
        objects: description of the objects in use, for the results: "none", or "learned" with the
            name and digest of the file of weights.

    Raises:
        InputError: the weights are missing, damaged or of another network, or ``objects`` is
            given and they have no learned objects.
    """

    def __init__(self, config: ObjConnectConfig) -> None:
        path = config.weights or shipped_path(SHIPPED)
        network, digest = read_network(path)
        config = _with_available_objects(config.drop_ineffective(), network, path)
        network.to(torch_device(config.device))
        fuse_layers(network, config.precision)
        search, self.objects = None, "none"
        if config.objects is not None:
            extract = MapExtractor(network, config.longest, config.precision)
            search = ObjectSearch(network, extract, config.objects)
            self.objects = f"learned, {path.name} {digest}"
        super().__init__("objconnect", network, digest, config, search)


def _with_available_objects(
    config: ObjConnectConfig, network: ObjConnectNet, path: Path
) -> ObjConnectConfig:
    """Return the options without ``objects`` if the weights of a file have no learned objects.

    Raises:
        InputError: ``objects`` is given with such weights.
    """
    if config.objects is None or network.constellation is not None:
        return config
    if "objects" in config.model_fields_set:
        raise InputError(
            f"option objects needs learned objects, which the weights {path} do not have: give "
            "objects=null, or other weights"
        )
    log.warning(
        "%s has no learned objects: images without a prior are localized without them", path
    )
    return config.model_copy(update={"objects": None})
