"""Convert weights of object-connect to PixLoc, so that both trainings begin with equal weights.

    python -m experiments.convert_to_pixloc WEIGHTS OUT

It writes the layers of WEIGHTS that both networks have (features, confidences and damping) as
weights of PixLoc.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from objconnect.learning.checkpoint import load_into, write_weights
from objconnect.learning.pixloc_net import PixlocNet, PixlocNetConfig
from objconnect.network.network import read_network
from objconnect.scene.errors import InputError


def convert_to_pixloc(weights: Path) -> PixlocNet:
    """Return the network of PixLoc with the weights that it shares with one of object-connect.

    Raises:
        InputError: the file is damaged, of another network, or has a decoder that PixLoc lacks.
    """
    network, _ = read_network(weights)
    if network.config.decoder != "unet":
        raise InputError(
            f"{weights} has a feature pyramid, which PixLoc lacks: give weights with decoder unet"
        )
    source = network.config
    config = PixlocNetConfig(
        width=source.width, decoder=source.steps, strides=source.strides, dims=source.dims
    )
    peer = PixlocNet(config)
    shared = network.state_dict()
    load_into(peer, {name: shared[name] for name in peer.state_dict()}, weights)
    return peer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("weights", type=Path)
    parser.add_argument("out", type=Path)
    args = parser.parse_args()
    network = convert_to_pixloc(args.weights)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    write_weights(args.out, network, network.config.model_dump(mode="json"))


if __name__ == "__main__":
    main()
