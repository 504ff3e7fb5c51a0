"""The object-connect network as a localizer: aligned like PixLoc's, from many starts."""

from __future__ import annotations

from baselines.featuremetric.localizer import FeaturemetricConfig, FeaturemetricLocalizer
from baselines.weights import shipped
from objconnect.network import read_network


class ObjConnectConfig(FeaturemetricConfig):
    """Options of the objconnect localizer, which looks around its start too."""

    multistart: bool = True


class ObjConnectLocalizer(FeaturemetricLocalizer):
    """See the module.

    Raises:
        InputError: the weights are missing or not of this network.
    """

    def __init__(self, config: ObjConnectConfig) -> None:
        network, digest = read_network(config.weights or shipped("objconnect"))
        super().__init__("objconnect", network, digest, config)
