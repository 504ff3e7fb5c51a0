"""Feature maps of an image: resized, through the network, level by level."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from baselines.align.sampling import sample
from baselines.pixloc.network import PixlocNet

Precision = Literal["float32", "bfloat16"]


@dataclass(frozen=True)
class FeatureMap:
    """One level of one image.

    Attributes:
        features: (1, C, h, w), not normalised.
        confidence: (1, 1, h, w) in 0..1.
        stride: pixels of the image, as it was before resizing, per cell in x and y.
    """

    features: Tensor
    confidence: Tensor
    stride: tuple[float, float]

    def sample(self, xy: Tensor) -> tuple[Tensor, Tensor]:
        """Unit features (N, C) and confidence (N,) at pixels (N, 2); those less than half a cell
        from the edge of the map take the value there."""
        height, width = self.features.shape[-2:]
        stride = xy.new_tensor(self.stride)
        within = torch.maximum(xy, stride / 2)
        within = torch.minimum(within, stride * xy.new_tensor([width - 0.5, height - 0.5]))
        features, _ = sample(self.features, within[None], self.stride)
        confidence, _ = sample(self.confidence, within[None], self.stride)
        return torch.nn.functional.normalize(features[0], dim=-1), confidence[0, :, 0]


class MapExtractor:
    """Runs the network on images of any size.

    Args:
        network: trained.
        longest: images with a longer side (px) are made smaller, as the authors do.
        precision: of the convolutions. bfloat16 is fast where the processor has units for it.
    """

    def __init__(self, network: PixlocNet, longest: int, precision: Precision) -> None:
        self.network = network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._longest = longest
        self._bfloat16 = precision == "bfloat16"

    @torch.inference_mode()
    def __call__(self, rgb: NDArray[np.uint8]) -> list[FeatureMap]:
        """Levels of an (H, W, 3) image, coarse to fine; its sides must be at least 16 pixels, after
        resizing too."""
        height, width = rgb.shape[:2]
        pixels, size = rgb.astype(np.float32), self._size(rgb)
        if size != (width, height):
            pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_LINEAR))
        # Rows of pixels of RGB are channels-last as they are.
        image = torch.from_numpy(pixels).permute(2, 0, 1)[None] / 255
        with torch.autocast("cpu", torch.bfloat16, enabled=self._bfloat16):
            levels = self.network(image)
        scale = width / size[0], height / size[1]
        return [
            FeatureMap(features, confidence, (stride * scale[0], stride * scale[1]))
            for stride, (features, confidence) in zip(
                self.network.config.strides, levels, strict=True
            )
        ]

    def shorter_side(self, rgb: NDArray[np.uint8]) -> int:
        """Pixels of the shorter side, as the network would see it."""
        return min(self._size(rgb))

    def _size(self, rgb: NDArray[np.uint8]) -> tuple[int, int]:
        """Width and height after resizing."""
        height, width = rgb.shape[:2]
        scale = min(self._longest / max(height, width), 1.0)
        return round(width * scale), round(height * scale)
