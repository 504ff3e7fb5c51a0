from __future__ import annotations

import sys
from pathlib import Path

import pytest
import torch

from experiments.convert_to_pixloc import convert_to_pixloc, main
from objconnect.learning.checkpoint import write_weights
from objconnect.learning.pixloc_net import read_network
from objconnect.network.localizer import SHIPPED
from objconnect.network.network import read_network as read_ours
from objconnect.scene.errors import InputError
from tests.objconnect.network.made import pictures
from tests.objconnect.network.test_network import network


def test_features_are_those_of_the_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The shipped network without its objects, read back as PixLoc's."""
    out = tmp_path / "made" / "weights.safetensors"
    monkeypatch.setattr(sys, "argv", ["convert_to_pixloc", str(SHIPPED), str(out)])
    main()
    peer, _ = read_network(out)
    ours, _ = read_ours(SHIPPED)
    image = pictures(1, 64, 96)
    with torch.no_grad():
        for level, other in zip(ours(image), peer(image), strict=True):
            assert torch.equal(level[0], other[0])
            assert torch.equal(level[1], other[1])
    for damping, other_damping in zip(ours.damping, peer.damping, strict=True):
        assert torch.equal(damping(), other_damping())


def test_a_pyramid_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "weights.safetensors"
    made = network(decoder="fpn")
    write_weights(path, made, made.config.model_dump(mode="json"))
    with pytest.raises(InputError, match="feature pyramid"):
        convert_to_pixloc(path)
