"""The network is the authors', and takes their weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from objconnect.learning.checkpoint import write_weights
from objconnect.learning.pixloc_net import PixlocNet, PixlocNetConfig, read_network
from objconnect.learning.unet import _decode
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError
from tests.baselines.pixloc import official

TOLERANCE = 1e-4


@pytest.mark.parametrize("extra", [0, 1], ids=["vgg16", "vgg19"])
def test_equals_the_authors(extra: int) -> None:
    network = official.ours(extra)
    recorded = np.load(official.RECORDED)
    for height, width in official.SIZES:
        with torch.no_grad():
            levels = network(official.picture(height, width))
        assert len(levels) == 3
        for level, pair in enumerate(levels):
            for kind, values in zip(("feature_maps", "confidences"), pair, strict=True):
                name = f"vgg{16 + 3 * extra}/{height}x{width}/{kind}/{level}"
                assert values.shape == tuple(recorded[f"{name}/shape"])
                np.testing.assert_allclose(
                    official.sample(values), recorded[name], rtol=0, atol=TOLERANCE
                )


def test_damping_of_the_authors() -> None:
    network = official.ours()
    theirs = official.tensors()
    # Their level 0 is the finest, their tangent is translation then rotation.
    for ours, level in zip(network.damping, (2, 1, 0), strict=True):
        const = theirs[f"optimizer.{level}.dampingnet.const"]
        torch.testing.assert_close(ours.theta.data, torch.cat([const[3:], const[:3]]))


def test_written_weights_come_back(tmp_path: Path) -> None:
    config = PixlocNetConfig(width=0.125, strides=(16, 4, 2), dims=(24, 16, 8))
    network = PixlocNet(config).eval()
    path = tmp_path / "pixloc.safetensors"
    write_weights(path, network, config.model_dump())
    again, digest = read_network(path)
    assert again.config == config and len(digest) == 64
    image = official.picture(48, 64)
    with torch.no_grad():
        for (a, u), (b, v), stride, dim in zip(
            network(image), again(image), config.strides, config.dims, strict=True
        ):
            assert a.shape == (1, dim, 48 // stride, 64 // stride)
            # What is read is laid out in memory to be fast, and adds up in another order.
            assert torch.allclose(a, b, atol=1e-5) and torch.allclose(u, v, atol=1e-5)
    for name, tensor in network.state_dict().items():
        assert torch.equal(tensor, again.state_dict()[name])


def test_bad_weights_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no weights at"):
        read_network(tmp_path / "none.tar")
    lacking = dict(official.tensors())
    del lacking["optimizer.1.dampingnet.const"], lacking["extractor.uncertainty.0.0.bias"]
    torch.save({"model": lacking}, tmp_path / "lacking.tar")
    with pytest.raises(InputError, match=r"lacking.tar"):
        read_network(tmp_path / "lacking.tar")
    torch.save({"model": {"extractor.encoder.0.0.weight": torch.zeros(3)}}, tmp_path / "a.tar")
    with pytest.raises(InputError, match=r"a.tar"):
        read_network(tmp_path / "a.tar")


@pytest.mark.parametrize(
    "wrong",
    [
        *({"strides": (16, 3)}, {"strides": (4, 16, 1)}, {"dims": (8,)}, {"width": 0}),
        *({"dims": (8, 8, 10**6)}, {"decoder": (64, 64, 64, 10**6)}, {"decoder": (0, 8, 8, 8)}),
    ],
)
def test_a_bad_configuration_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError):
        load_config(PixlocNetConfig, None, wrong)


@pytest.mark.parametrize("size", [(160, 64), (272, 96), (301, 77)])
def test_rows_are_decoded_as_the_whole(size: tuple[int, int]) -> None:
    """Maps of more than 64 rows are decoded some rows at a time, to the same values."""
    torch.manual_seed(1)
    decoder = PixlocNet(PixlocNetConfig(width=0.125, decoder=(16, 16, 8, 8))).decoder.eval()
    coarse = torch.rand(1, 8, size[0] // 2, size[1] // 2)
    skip = torch.rand(1, 8, *size)
    step = decoder[3]
    with torch.no_grad():
        step[1].running_mean.uniform_(-1, 1)
        (rows,) = _decode(step, coarse, skip, lambda maps: (maps,))
        up = torch.nn.functional.interpolate(coarse, scale_factor=2.0, mode="bilinear")
        whole = step(torch.cat([up, skip[..., : up.shape[-2], : up.shape[-1]]], 1))
    assert rows.shape == whole.shape == (1, 8, size[0] // 2 * 2, size[1] // 2 * 2)
    assert torch.allclose(rows, whole, atol=1e-6)
    assert whole.std() > 0.1


@pytest.mark.parametrize("turn", [0.3, 0.8])
def test_only_what_is_shown_is_decoded(turn: float) -> None:
    """Cells that show a turned photograph are decoded as in the whole, and far ones are zero."""
    torch.manual_seed(1)
    config = PixlocNetConfig(width=0.125, decoder=(16, 16, 8, 8), strides=(16, 4, 2))
    network = PixlocNet(config).eval()
    size = (416, 464)
    y, x = np.meshgrid(*(np.arange(1, side, 2) - side / 2 for side in size), indexing="ij")
    along, across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    shown = (abs(along) < 150) & (abs(across) < 120)
    image = torch.rand(1, 3, *size)
    with torch.no_grad():
        part, whole = network(image, needed=shown), network(image)
        nothing = network(image, needed=np.zeros_like(shown))
    wanted = torch.from_numpy(shown)
    for level, (a, b) in enumerate(zip(part, whole, strict=True)):
        here = wanted[:: (8, 2, 1)[level], :: (8, 2, 1)[level]]
        for ours, all_cells in zip(a, b, strict=True):
            assert torch.allclose(ours[..., here], all_cells[..., here], atol=1e-5)
    for ours, all_cells in zip(part[2], whole[2], strict=True):
        assert not ours[..., 0, 0].any() and all_cells[..., 0, 0].all()
    assert torch.equal(nothing[2][0], whole[2][0])
