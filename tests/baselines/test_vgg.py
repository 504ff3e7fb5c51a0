from __future__ import annotations

import pytest
import torch
from torch import nn

from baselines.pixloc.network import PixlocNet, PixlocNetConfig
from baselines.vgg import encode
from objconnect.config import ObjConnectNetConfig
from objconnect.network import ObjConnectNet


@pytest.mark.parametrize(
    "made",
    [
        lambda: PixlocNet(PixlocNetConfig(width=0.25)),
        lambda: ObjConnectNet(ObjConnectNetConfig(width=0.25)),
    ],
    ids=["pixloc", "objconnect"],
)
@torch.no_grad()
def test_networks_that_begin_from_nothing_see_in_all_their_blocks(made: type[nn.Module]) -> None:
    """Thirteen layers, each a third of the variance, would leave the last one blind."""
    torch.manual_seed(0)
    encoder = made().encoder
    assert isinstance(encoder, nn.ModuleList)
    first, *_, last = (block.std() for block in encode(encoder, torch.rand(2, 3, 96, 96)))
    assert 0.2 < last / first < 5
