"""PixLoc as a localizer: its network, aligned to the nearest photographs of the map."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from pydantic import Field

from baselines.checkpoint import shipped
from baselines.featuremetric.localizer import FeaturemetricLocalizer
from baselines.featuremetric.options import FeaturemetricConfig
from baselines.pixloc.network import read_network

SHIPPED: Final = Path(__file__).with_name("pixloc.safetensors")
"""The weights that come with the project."""


class PixlocConfig(FeaturemetricConfig):
    """Options of the pixloc localizer: aligned once, to the map's own points, as by its authors.

    ``weights`` may be a checkpoint of the authors'.
    """

    corners: int = Field(0, ge=0)


class PixlocLocalizer(FeaturemetricLocalizer):
    """See the module.

    Raises:
        InputError: the weights are missing or not of this network.
    """

    def __init__(self, config: PixlocConfig) -> None:
        network, digest = read_network(config.weights or shipped(SHIPPED))
        super().__init__("pixloc", network, digest, config)
