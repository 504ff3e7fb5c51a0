"""Networks in integers of eight bits give nearly what they give in floating point."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.nn import functional

import objconnect.learning.quantization as quantization
from objconnect.learning.inference import fuse_layers
from objconnect.learning.quantization import largest_values, quantize, upsample
from objconnect.localization.featuremetric.quantized import channel_scales
from objconnect.methods import create
from objconnect.network.localizer import SHIPPED
from objconnect.network.network import read_network
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Prior, Query, Status
from tests.baselines.pixloc.made_map import CAMERA, looking_down, photograph, write_map
from tests.objconnect.learning.test_inference import networks, train

STRIDES = (16, 4, 1)
needs_units = pytest.mark.skipif(
    not torch.cpu._is_vnni_supported(), reason="the processor has no units for integers (VNNI)"
)


def pictures(count: int) -> torch.Tensor:
    """Blobs of several sizes and colours."""
    torch.manual_seed(5)
    coarse = [torch.rand(count, 3, side, 2 * side) for side in (3, 9, 27, 81)]
    sized = [functional.interpolate(each, (96, 176), mode="bilinear") for each in coarse]
    mean = torch.stack(sized).mean(0)
    return mean.contiguous(memory_format=torch.channels_last)


def similarity(a: torch.Tensor, b: torch.Tensor) -> float:
    """Return the mean cosine between features (B, C, h, w)."""
    return float(functional.cosine_similarity(a.float(), b.float(), dim=1).mean())


@needs_units
@pytest.mark.parametrize("method", ["pixloc", "objconnect"])
def test_features_are_nearly_the_same(method: str) -> None:
    network = train(networks()[0]) if method == "pixloc" else read_network(SHIPPED)[0]
    fuse_layers(network, "float32")
    seen = pictures(4)
    with torch.inference_mode():
        with largest_values(network) as largest:
            network(seen[:3])
        exact = network(seen[3:])
        strides = STRIDES if method == "pixloc" else (16, 4, 2)
        made = quantize(network, channel_scales(largest), strides)
        ours = made(seen[3:])
        again = network(seen[3:])
        # Eight bits differ, and far less than another picture does.
        others = network(seen[:1])
    for (a, sure), (b, truth), (same, _), (other, _) in zip(
        ours, exact, again, others, strict=True
    ):
        assert a.shape == b.shape and torch.equal(same, b)
        assert 0.98 < similarity(a, b) < 1 - 1e-6
        assert 1 - similarity(a, b) < (1 - similarity(other, b)) / 5
        assert float((sure.float() - truth).abs().mean()) < 0.05


@needs_units
def test_parts_that_are_not_shown_change_nothing() -> None:
    network, _ = read_network(SHIPPED)
    fuse_layers(network, "float32")
    seen = pictures(1)
    shown = np.zeros((48, 88), np.bool_)
    shown[8:30, 20:50] = True
    with torch.inference_mode():
        with largest_values(network) as largest:
            network(seen)
        steps = channel_scales(largest)
        made = quantize(network, steps, network.config.strides)
        whole, part = (made(seen, needed=each)[-1][0] for each in (None, shown))
    torch.testing.assert_close(whole[..., 8:30, 20:50], part[..., 8:30, 20:50])


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (8, 8)])
def test_doubling_rounds_bilinear_values(
    size: tuple[int, int], compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quantization, "supports_loops", lambda device: compiled)
    torch.manual_seed(2)
    maps = torch.randint(0, 256, (2, 6, *size), dtype=torch.uint8)
    maps = maps.contiguous(memory_format=torch.channels_last)
    exact = functional.interpolate(maps.float(), scale_factor=2.0, mode="bilinear")
    made = upsample(maps)
    assert made.dtype == torch.uint8
    assert float((made.float() - exact).abs().max()) <= 0.5
    torch.testing.assert_close(upsample(maps.float()), exact)


def test_what_cannot_be_quantized_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    pyramid = networks()[2].eval()
    fuse_layers(pyramid, "float32")
    monkeypatch.setattr(torch.cpu, "_is_vnni_supported", lambda: True)
    with pytest.raises(InputError, match=r"quantized=true needs a network with a U-Net decoder"):
        quantize(pyramid, {}, STRIDES)
    monkeypatch.setattr(torch.cpu, "_is_vnni_supported", lambda: False)
    with pytest.raises(InputError, match=r"quantized=true needs a processor .*VNNI"):
        quantize(pyramid, {}, STRIDES)


def test_a_layer_of_zeros() -> None:
    steps = channel_scales({"layer": torch.zeros(4), "other": torch.ones(4)})
    assert all(bool((each > 0).all()) for each in steps.values())


@pytest.mark.parametrize("method", ["objconnect", "pixloc", "pixloc-search"])
def test_it_is_said_before_a_map_is_prepared(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cpu, "_is_vnni_supported", lambda: False)
    with pytest.raises(InputError, match=r"quantized=true needs a processor .*VNNI"):
        create(method, {"quantized": True})


@needs_units
@pytest.mark.parametrize(("method", "share"), [("objconnect", 1.5), ("pixloc", 1.0)])
def test_poses_are_found(method: str, share: float, tmp_path: Path, cache: Path) -> None:
    """They are those of floating point. Weights of `objconnect` are less exact than PixLoc's on
    these painted pictures, in floating point too, and may be further from the truth by this share.
    """
    truth, start = looking_down(9.3, -0.4, (1.5, -1.0, 4.0)), looking_down(8.9, -0.1, (0.5, 0, 3))
    prior = Prior(start.centre().numpy(), None, start.rotation.numpy(), None)
    sparse_map, images = write_map(tmp_path / "images"), tmp_path / "images"
    poses = []
    for quantized_too in (True, False):
        localizer = create(method, {"quantized": quantized_too})
        localizer.prepare(sparse_map, images, cache)
        found = localizer.localize(Query("query.png", photograph(truth), CAMERA, prior))
        assert found.status is Status.OK and found.cam_from_world is not None
        poses.append(found.cam_from_world)
    metres, degrees = poses[0].error_to(poses[1])
    assert float(metres) < 0.1 and float(degrees) < 0.25
    metres, degrees = poses[0].error_to(truth)
    assert float(metres) < 0.1 * share and float(degrees) < 0.25 * share


@needs_units
def test_the_network_of_the_map_is_left_alone() -> None:
    network = networks()[0].eval()
    fuse_layers(network, "float32")
    before = copy.deepcopy(network.state_dict())
    with torch.inference_mode(), largest_values(network) as largest:
        network(pictures(1))
    quantize(network, channel_scales(largest), STRIDES)
    assert not any(module._forward_hooks for module in network.modules())
    for name, value in network.state_dict().items():
        torch.testing.assert_close(value, before[name], rtol=0, atol=0)
