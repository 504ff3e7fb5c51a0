"""PixLoc as a localizer: its network, aligned to the nearest photographs of the map."""

from __future__ import annotations

from baselines.featuremetric.localizer import FeaturemetricConfig, FeaturemetricLocalizer
from baselines.pixloc.network import read_network
from baselines.weights import shipped


class PixlocConfig(FeaturemetricConfig):
    """Options of the pixloc localizer; ``weights`` may be a checkpoint of the authors'."""


class PixlocLocalizer(FeaturemetricLocalizer):
    """See the module.

    Raises:
        InputError: the weights are missing or not of this network.
    """

    def __init__(self, config: PixlocConfig) -> None:
        network, digest = read_network(config.weights or shipped("pixloc"))
        super().__init__("pixloc", network, digest, config)
