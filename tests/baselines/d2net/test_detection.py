from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from baselines.d2net.detection import detect, find_peaks
from baselines.d2net.localizer import SHIPPED
from baselines.d2net.network import D2Net, D2NetNetConfig, DenseD2Net, read_network
from objconnect.learning.checkpoint import write_weights
from objconnect.scene.errors import InputError
from tests.baselines.d2net import official

SLIM = D2NetNetConfig(width=0.125)


def slim(symmetric: bool = False) -> D2Net:
    torch.manual_seed(0)
    network = D2Net(SLIM).eval().requires_grad_(False)
    for layer in network.modules():
        if symmetric and isinstance(layer, nn.Conv2d):
            layer.weight += layer.weight.flip(2)
            layer.weight += layer.weight.flip(3)
    return network


def dense(network: D2Net) -> DenseD2Net:
    return DenseD2Net(network, "float32")


def picture() -> Tensor:
    return torch.from_numpy(official.pictures()[0].copy()).permute(2, 0, 1).float() / 255


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_keypoints_of_a_mirrored_picture_are_mirrored(scale: float) -> None:
    """With symmetric kernels the network commutes with mirrors, and its pixels must too."""
    network = dense(slim(symmetric=True))
    found = detect(network, picture(), [scale])
    mirrored = detect(network, picture().flip(1, 2), [scale])
    assert len(found.xy) == len(mirrored.xy) > 0
    back = torch.tensor([official.WIDTH, official.HEIGHT]) - mirrored.xy
    distance = torch.cdist(found.xy, back).amin(1)
    assert distance.max() < 1e-3


def test_levels_agree_on_where_a_corner_is() -> None:
    """A level twice as fine sees the coarser one's picture when that is enlarged beforehand."""
    network, image = dense(slim()), picture()
    large = nn.functional.interpolate(
        image[None], scale_factor=2, mode="bilinear", align_corners=True
    )[0]
    fine, enlarged = detect(network, image, [2.0]), detect(network, large, [1.0])
    # Enlarging keeps the centres of the corner pixels where they are.
    size = torch.tensor([official.WIDTH, official.HEIGHT])
    back = (enlarged.xy - 0.5) * (size - 1) / (2 * size - 1) + 0.5
    assert torch.allclose(fine.xy, back, atol=1e-3)
    assert torch.allclose(fine.descriptors, enlarged.descriptors, atol=1e-4)


def test_keypoints_in_bfloat16_are_those_in_single_precision() -> None:
    network, _ = read_network(SHIPPED)
    single, rounded = (
        detect(DenseD2Net(network, precision), picture(), [2.0])
        for precision in ("float32", "bfloat16")
    )
    distance, nearest = torch.cdist(single.xy, rounded.xy).min(1)
    assert (distance < 0.25).float().mean() > 0.9
    cosine = (single.descriptors * rounded.descriptors[nearest]).sum(1)
    assert cosine[distance < 0.25].min() > 0.99
    # One keypoint a peak: rounding makes no plateaus.
    assert len(rounded.xy) == pytest.approx(len(single.xy), rel=0.05)


def bump(x: float, y: float, across: float = 1.0) -> Tensor:
    """A parabola over 7 x 9 cells that is highest at (x, y)."""
    rows, columns = torch.meshgrid(torch.arange(7.0), torch.arange(9.0), indexing="ij")
    return 90 - (columns - x) ** 2 - across * (rows - y) ** 2


def test_a_parabola_peaks_where_it_does() -> None:
    peaks, offsets = find_peaks(torch.stack([bump(4.3, 2.8), torch.full((7, 9), 5.0)]))
    assert peaks.nonzero().tolist() == [[3, 4]]
    assert offsets[:, 3, 4].tolist() == pytest.approx([0.3, -0.2], abs=1e-4)


def test_an_edge_and_a_weaker_channel_are_no_peaks() -> None:
    assert not find_peaks(bump(4, 3, across=0.1)[None])[0].any()
    assert find_peaks(bump(4, 3, across=0.25)[None])[0].sum() == 1
    stronger = torch.full((7, 9), 91.0)
    assert not find_peaks(torch.stack([bump(4, 3), stronger]))[0][3, 4]


def test_a_blank_picture_has_keypoints_at_most_at_its_border() -> None:
    """Where the padding of the convolutions reaches."""
    found = detect(dense(slim()), torch.full((3, 192, 192), 0.5), [1, 2])
    assert not ((found.xy > 48) & (found.xy < 144)).all(1).any()
    assert torch.isfinite(found.descriptors).all()


def test_a_picture_too_small_for_any_level_has_no_keypoints() -> None:
    found = detect(dense(slim()), torch.rand(3, 7, 200), [0.5, 1, 2])
    assert found.xy.shape == (0, 2)
    assert found.descriptors.shape == (0, 64)


def test_weights_are_read_as_they_were_written(tmp_path: Path) -> None:
    path = tmp_path / "slim.safetensors"
    network = slim()
    write_weights(path, network, SLIM.model_dump(mode="json"))
    read, digest = read_network(path)
    assert read.config == SLIM
    assert len(digest) == 64
    assert torch.equal(dense(read)(picture()[None]), dense(network)(picture()[None]))


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.pth"
    torch.save({"model": {"weight": torch.ones(3)}}, path)
    with pytest.raises(InputError, match="holds no weights of D2-Net"):
        read_network(path)
    torch.save({"model": {**slim().state_dict(), "extra": torch.ones(1)}}, path)
    with pytest.raises(InputError, match="has extra, which this network lacks"):
        read_network(path)
    tensors = slim().state_dict()
    tensors["dense_feature_extraction.model.21.bias"][0] = np.nan
    torch.save({"model": tensors}, path)
    with pytest.raises(InputError, match="not finite"):
        read_network(path)
