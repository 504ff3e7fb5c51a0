"""Networks made ready for inference give what they gave before."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import nn

from objconnect.learning.inference import ConvReLU, Pooling, fuse_layers
from objconnect.learning.pixloc_net import PixlocNet, PixlocNetConfig
from objconnect.network.coarse_localizer import CoarseLocalizerConfig
from objconnect.network.config import ObjConnectNetConfig
from objconnect.network.localizer import ObjConnectConfig
from objconnect.network.network import ObjConnectNet


def train(network: nn.Module) -> nn.Module:
    """Give every batch normalisation statistics and weights of its own."""
    torch.manual_seed(3)
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            assert module.running_mean is not None and module.running_var is not None
            module.running_mean.uniform_(-0.5, 0.5)
            module.running_var.uniform_(0.5, 2)
            nn.init.uniform_(module.weight, 0.5, 1.5)
            nn.init.uniform_(module.bias, -0.5, 0.5)
    return network.eval()


def networks() -> list[nn.Module]:
    small = PixlocNetConfig(width=0.125, decoder=(16, 16, 8, 8), dims=(16, 16, 8))
    objects = {"width": 0.125, "dims": (16, 16, 8)}
    return [
        PixlocNet(small),
        ObjConnectNet(ObjConnectNetConfig(**objects, steps=(16, 16, 8, 8))),
        ObjConnectNet(ObjConnectNetConfig(**objects, decoder="fpn", pyramid=16)),
    ]


@pytest.mark.parametrize("which", range(3), ids=["pixloc", "unet", "fpn"])
def test_folded_networks_are_the_same(which: int) -> None:
    plain = train(networks()[which])
    folded = copy.deepcopy(plain)
    fuse_layers(folded, "float32")
    assert any(isinstance(module, ConvReLU) for module in folded.modules())
    assert not any(isinstance(module, nn.BatchNorm2d) for module in folded.modules())
    image = torch.rand(1, 3, 80, 150).contiguous(memory_format=torch.channels_last)
    with torch.inference_mode():
        for ours, theirs in zip(folded(image), plain(image), strict=True):
            for a, b in zip(ours, theirs, strict=True):
                assert b.std() > 1e-3
                torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("size", [(6, 8), (7, 5), (1, 4)])
def test_pooling_is_that_of_torch(size: tuple[int, int], dtype: torch.dtype) -> None:
    maps = torch.randn(2, 3, *size).to(dtype).contiguous(memory_format=torch.channels_last)
    expected = nn.MaxPool2d(2)(maps) if min(size) > 1 else maps.new_empty(2, 3, 0, 2)
    assert torch.equal(Pooling()(maps), expected)


def test_bfloat16_is_near() -> None:
    plain = train(networks()[0])
    folded = copy.deepcopy(plain)
    fuse_layers(folded, "bfloat16")
    image = torch.rand(1, 3, 64, 64)
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16):
        half = folded(image)
    with torch.inference_mode():
        whole = plain(image)
    for (a, _), (b, _) in zip(half, whole, strict=True):
        assert a.dtype == torch.bfloat16
        assert 0 < float((a - b).norm() / b.norm()) < 0.03


@pytest.mark.parametrize("config", [ObjConnectConfig, CoarseLocalizerConfig])
@pytest.mark.parametrize(
    ("units", "used"),
    [
        ((True, True, "GenuineIntel"), "bfloat16"),
        ((False, True, "GenuineIntel"), "float32"),
        ((False, True, "AuthenticAMD"), "bfloat16"),
        ((False, False, "AuthenticAMD"), "float32"),
    ],
)
def test_configurations_record_the_precision_that_is_used(
    config: type[ObjConnectConfig],
    units: tuple[bool, bool, str],
    used: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    matrices, vectors, maker = units
    monkeypatch.setattr("torch.cpu._is_amx_tile_supported", lambda: matrices)
    monkeypatch.setattr("torch.cpu._is_avx512_bf16_supported", lambda: vectors)
    monkeypatch.setattr("objconnect.learning.inference.processor_maker", lambda: maker)
    assert config().model_dump()["precision"] == used
    assert config(precision="auto").precision == used
    assert config(precision="float32").precision == "float32"
