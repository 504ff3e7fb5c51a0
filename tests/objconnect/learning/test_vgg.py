from __future__ import annotations

import pytest
import torch
from torch import nn

from objconnect.learning.pixloc_net import PixlocNet, PixlocNetConfig
from objconnect.learning.vgg import encode, scale_to_unit, vgg16_encoder
from objconnect.network.config import ObjConnectNetConfig
from objconnect.network.network import ObjConnectNet


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


@pytest.mark.parametrize("height", [40, 131, 132, 133, 300, 301, 513])
@torch.no_grad()
def test_the_first_block_sees_an_image_in_strips_as_it_sees_it_whole(height: int) -> None:
    encoder = vgg16_encoder(0.125).eval()
    image = torch.randint(0, 256, (2, 3, height, 48), dtype=torch.uint8)
    strips = encode(encoder, image, finest=2)
    whole = encode(encoder.train(), image, finest=2)
    assert [maps.shape for maps in strips] == [maps.shape for maps in whole]
    for one, other in zip(strips, whole, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-5)


@torch.no_grad()
def test_images_of_bytes_are_seen_as_those_in_0_to_1() -> None:
    encoder = vgg16_encoder(0.125).eval()
    image = torch.randint(0, 256, (1, 3, 64, 48), dtype=torch.uint8)
    of_bytes, in_floats = encode(encoder, image), encode(encoder, scale_to_unit(image))
    assert all(map(torch.equal, of_bytes, in_floats))
