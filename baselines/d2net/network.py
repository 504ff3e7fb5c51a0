"""The network of D2-Net: VGG16 up to conv4_3 at two strides, and the soft detection score.

Source: Dusmanu et al., "D2-Net: A Trainable CNN for Joint Description and Detection of Local
Features", CVPR 2019. Parameters have the names of the authors' checkpoints,
``dense_feature_extraction.model.N``, so that these can be loaded.
"""

from __future__ import annotations

import copy
from collections import OrderedDict
from pathlib import Path
from typing import Final

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from objconnect.learning.checkpoint import load_into, read_weights
from objconnect.learning.inference import ConvReLU, Pooling
from objconnect.learning.vgg import channels, vgg16_blocks
from objconnect.scene.config import Config, load_config
from objconnect.scene.errors import InputError

STRIDE: Final = 8
"""Pixels per cell in training."""
# Means of blue, green and red in 0..255 that the authors' weights expect to be subtracted.
_MEANS: Final = (103.939, 116.779, 123.68)
# Approximate standard deviation after this subtraction.
_SPREAD: Final = 60.0
_FIRST_WEIGHT: Final = "dense_feature_extraction.model.0.weight"
_TINY: Final = 1e-12


class D2NetNetConfig(Config):
    """Configuration of the network."""

    width: float = Field(
        1.0,
        gt=0,
        le=1,
        description="Number of channels as a share of VGG16's; 1 is the authors' network.",
    )


class D2Net(nn.Module):
    """The network for training; ``DenseD2Net`` localizes with its weights.

    Attributes:
        channels: number of channels of the features.
    """

    def __init__(self, config: D2NetNetConfig) -> None:
        super().__init__()
        self.config = config
        self.channels = channels(config.width)[3]
        *first, last = vgg16_blocks(config.width)[:4]
        layers: list[nn.Module] = []
        for block in first:
            layers += [*block, nn.MaxPool2d(2)]
        # The features are those of conv4_3 before its ReLU.
        model = nn.Sequential(*layers, *last[:-1])
        self.dense_feature_extraction = nn.Sequential(OrderedDict(model=model))
        # Random initial weights give activations near one in every layer.
        convolutions = [layer for layer in model if isinstance(layer, nn.Conv2d)]
        for layer in convolutions:
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
            assert layer.bias is not None
            nn.init.zeros_(layer.bias)
        with torch.no_grad():
            convolutions[0].weight /= _SPREAD

    def forward(self, images: Tensor) -> Tensor:
        """Return the features for training. The centre of cell (x, y) is (8x + 4, 8y + 4).

        Args:
            images: (B, 3, H, W) float RGB in 0..1, at least 8 x 8.

        Returns:
            Features (B, C, H // 8, W // 8), of either sign.
        """
        features: Tensor = self.dense_feature_extraction(_convert_to_caffe(images))
        return features


class DenseD2Net(nn.Module):
    """The network for localization, with twice as many cells and with fused layers.

    The third pooling is an average with stride 1, and the convolutions after it are dilated, so
    that their receptive field is as in training. The average of 2 x 2 cells belongs to the corner
    between them, which lies half a cell right of and below the position that the authors' code
    reports.

    In bfloat16 the last convolution is still computed in single precision: bfloat16 has eight
    significant bits, so that features rounded to it would have plateaus instead of peaks.

    Attributes:
        channels: number of channels of the features.

    Args:
        network: trained network, which is not changed.
        precision: ``bfloat16`` or ``float32``.
    """

    def __init__(self, network: D2Net, precision: str) -> None:
        super().__init__()
        self.channels = network.channels
        rounded = torch.bfloat16 if precision == "bfloat16" else torch.float32
        layers: list[nn.Module] = []
        poolings = 0
        *first, last = _convolutions_and_poolings(network)
        for layer in first:
            poolings += isinstance(layer, nn.MaxPool2d)
            if isinstance(layer, nn.Conv2d):
                layers.append(ConvReLU(_dilate(layer) if poolings == 3 else layer, rounded))
            else:
                layers.append(nn.AvgPool2d(2, stride=1) if poolings == 3 else Pooling())
        assert isinstance(last, nn.Conv2d)
        layers.append(ConvReLU(_dilate(last), torch.float32))
        self._layers = nn.Sequential(*layers)

    def forward(self, images: Tensor) -> Tensor:
        """Return the features. The centre of cell (x, y) is (4x + 4, 4y + 4).

        Args:
            images: (B, 3, H, W) float RGB in 0..1, at least 8 x 8.

        Returns:
            Features (B, C, H // 4 - 1, W // 4 - 1), not negative.
        """
        features: Tensor = self._layers(_convert_to_caffe(images))
        return features


def _convolutions_and_poolings(network: D2Net) -> list[nn.Module]:
    layers = network.dense_feature_extraction[0].children()
    return [layer for layer in layers if not isinstance(layer, nn.ReLU)]


def _dilate(convolution: nn.Conv2d) -> nn.Conv2d:
    """Return a copy of a 3x3 convolution with a dilation of 2."""
    dilated = copy.deepcopy(convolution)
    dilated.padding = dilated.dilation = (2, 2)
    return dilated


def read_network(path: Path) -> tuple[D2Net, str]:
    """Read a network from our weights or the authors' checkpoint; return it with its digest.

    Raises:
        InputError: the file is missing or damaged, or its weights belong to another network.
    """
    weights = read_weights(path)
    # The authors' checkpoints do not state the width. It follows from the first layer.
    first = weights.tensors.get(_FIRST_WEIGHT)
    if first is None or not first.ndim:
        raise InputError(f"{path} lacks {_FIRST_WEIGHT}: it holds no weights of D2-Net")
    config = weights.config or {"width": len(first) / 64}
    network = D2Net(load_config(D2NetNetConfig, None, config))
    load_into(network, weights.tensors, path)
    return network.eval().requires_grad_(False), weights.sha256


def soft_scores(features: Tensor) -> Tensor:
    """Return the soft detection score of each cell.

    The score is high where a channel is larger than in the neighbouring cells and larger than the
    other channels of the cell.

    Args:
        features: (B, C, h, w), of either sign.

    Returns:
        Scores (B, h, w) float32, not negative, whose sum is one for each image. An image without a
        positive feature has scores of zero.
    """
    # The exponentials need single precision.
    positive = functional.relu(features.float())
    largest = positive.amax((1, 2, 3), keepdim=True).clamp_min(_TINY)
    exponential = torch.exp(positive / largest)
    around = 9 * functional.avg_pool2d(
        functional.pad(exponential, (1, 1, 1, 1), value=1.0), 3, stride=1
    )
    strongest = positive.amax(1, keepdim=True).clamp_min(_TINY)
    scores = (exponential / around * (positive / strongest)).amax(1)
    total: Tensor = scores.sum((1, 2), keepdim=True).clamp_min(_TINY)
    return scores / total


def _convert_to_caffe(images: Tensor) -> Tensor:
    """Convert RGB (B, 3, H, W) in 0..1 to BGR in 0..255 with the means subtracted."""
    means = images.new_tensor(_MEANS).view(3, 1, 1)
    return images.flip(1) * 255 - means
