"""The network of PixLoc: a U-Net on VGG16 with features and confidences at several strides.

It follows Sarlin et al. (CVPR 2021) and their code (github.com/cvg/pixloc, commit 65a51a7). Their
weights can be loaded.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator
from torch import Tensor, nn

from objconnect.learning.checkpoint import load_into, read_weights
from objconnect.learning.damping import Damping
from objconnect.learning.unet import Channels, Decoder, Level, check_levels
from objconnect.learning.vgg import encode, initialise_convolutions, vgg16_encoder
from objconnect.scene.config import Config, describe
from objconnect.scene.errors import InputError


class PixlocNetConfig(Config):
    """Configuration of the network. Levels run from coarse to fine."""

    width: float = Field(
        1.0, gt=0, le=2, description="Number of channels of the encoder as a share of VGG16's."
    )
    decoder: tuple[Channels, Channels, Channels, Channels] = Field(
        (64, 64, 64, 32),
        description="Numbers of channels of the decoder's steps at strides 8, 4, 2 and 1.",
    )
    extra_convolutions: int = Field(
        0,
        ge=0,
        le=1,
        description="Number of additional convolutions in each of the last three blocks of the "
        "encoder; 0 is VGG16 and 1 is VGG19.",
    )
    strides: tuple[int, ...] = Field(
        (16, 4, 1), min_length=1, description="Strides of the levels, px per cell."
    )
    dims: tuple[Channels, ...] = Field(
        (128, 128, 32),
        min_length=1,
        description="Numbers of channels of the features of each level.",
    )

    @model_validator(mode="after")
    def _check_levels(self) -> Self:
        check_levels(self.strides, self.dims)
        return self


class PixlocNet(nn.Module):
    """The network of PixLoc, with the damping of the alignment that is trained with it.

    Attributes:
        damping: a module for each level, coarse to fine, that returns damping factors (6,).
    """

    def __init__(self, config: PixlocNetConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = vgg16_encoder(config.width, config.extra_convolutions)
        self.decoder = Decoder(config.width, config.decoder, config.strides)
        sizes = self.decoder.sizes
        self.features = nn.ModuleList(
            nn.Conv2d(size, dim, 1) for size, dim in zip(sizes, config.dims, strict=True)
        )
        self.confidence = nn.ModuleList(nn.Conv2d(size, 1, 1) for size in sizes)
        self.damping = nn.ModuleList(Damping() for _ in config.strides)
        initialise_convolutions(self)

    def forward(
        self, image: Tensor, levels: int | None = None, needed: NDArray[np.bool_] | None = None
    ) -> list[tuple[Tensor, Tensor]]:
        """Return features, which are not normalised, and confidences in 0..1, coarse to fine.

        Args:
            image: images (B, 3, H, W), RGB in 0..1 or of bytes; H and W are at least 16.
            levels: number of levels from the coarsest; None for all.
            needed: cells of the finest level that are needed, as for ``Decoder.levels``.

        Returns:
            Features (B, C, h, w) and confidences (B, 1, h, w) of each level. Cells are as many
            pixels wide as the level's stride and start at the top left corner. The part of an image
            beyond a multiple of 16 pixels is cut off.
        """
        blocks = encode(self.encoder, image, self.config.strides[-1])
        heads = [partial(self._level, number) for number in range(len(self.features))]
        outputs = islice(self.decoder.levels(blocks, heads, needed), levels)
        return [(features, confidence) for features, confidence in outputs]

    def _level(self, number: int, maps: Tensor) -> Level:
        # The sign is negative because the authors' head predicts the uncertainty.
        return self.features[number](maps), torch.sigmoid(-self.confidence[number](maps))


def read_network(path: Path) -> tuple[PixlocNet, str]:
    """Read a network from weights of this package or from a checkpoint of PixLoc's authors; return
    it with the digest of the file.

    Raises:
        InputError: the file does not exist, is damaged, or belongs to another network.
    """
    weights = read_weights(path)
    tensors, values = weights.tensors, weights.config
    if any(name.startswith("extractor.") for name in tensors):
        tensors, values = _from_official(tensors)
    try:
        config = PixlocNetConfig.model_validate(values)
    except ValidationError as error:
        raise InputError(describe(error, PixlocNetConfig, f"in {path}")) from None
    network = PixlocNet(config)
    load_into(network, tensors, path)
    # torch's annotations lack this argument.
    network = network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return network, weights.sha256


def _from_official(tensors: Mapping[str, Tensor]) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Rename the tensors of the authors' checkpoint; return them with the network's configuration.

    The authors' levels run from fine to coarse, and their tangent is translation, then rotation.
    """
    head = re.compile(r"extractor\.(adaptation|uncertainty)\.(\d+)\.0\.(weight|bias)")
    heads = [match for name in tensors if (match := head.fullmatch(name))]
    last = max((int(match[2]) for match in heads), default=0)
    renamed: dict[str, Tensor] = {}
    for name, tensor in tensors.items():
        if match := head.fullmatch(name):
            kind = "features" if match[1] == "adaptation" else "confidence"
            renamed[f"{kind}.{last - int(match[2])}.{match[3]}"] = tensor
        elif match := re.fullmatch(r"optimizer\.(\d+)\.dampingnet\.const", name):
            renamed[f"damping.{last - int(match[1])}.theta"] = tensor.roll(3)
        else:
            renamed[name.removeprefix("extractor.").replace(".layers.", ".")] = tensor
    weights = [renamed.get(f"features.{level}.weight") for level in range(last + 1)]
    dims = [len(weight) for weight in weights if weight is not None]
    return renamed, {"dims": dims, "extra_convolutions": int("encoder.2.7.weight" in renamed)}
