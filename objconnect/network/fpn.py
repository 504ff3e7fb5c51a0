"""The feature pyramid on VGG16's blocks: Lin et al., "Feature Pyramid Networks", CVPR 2017."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from torch import Tensor, nn
from torch.nn import functional

from objconnect.learning.unet import STRIDES
from objconnect.learning.vgg import channels


class FeaturePyramid(nn.Module):
    """The feature maps I_l of an image at several strides.

    Lateral 1x1 convolutions bring the encoder's blocks to the same number of channels. Coarser maps
    are resized bilinearly and added to finer ones. A 3x3 convolution smooths each level's map.

    Attributes:
        sizes: channels of each level, coarse to fine.
    """

    def __init__(self, width: float, size: int, strides: tuple[int, ...]) -> None:
        """Build a pyramid.

        Args:
            width: channels of the encoder as a share of VGG16's.
            size: channels of each level.
            strides: pixels per cell of each level, coarse to fine.
        """
        super().__init__()
        self.sizes = [size] * len(strides)
        self._level_steps = [STRIDES.index(stride) for stride in strides]
        depths = channels(width)[::-1][: self._level_steps[-1] + 1]
        self.lateral = nn.ModuleList(nn.Conv2d(depth, size, 1) for depth in depths)
        self.smooth = nn.ModuleList(
            nn.Sequential(
                nn.Conv2d(size, size, 3, padding=1, bias=False),
                nn.BatchNorm2d(size),
                nn.ReLU(inplace=True),
            )
            for _ in strides
        )

    def forward(self, blocks: Sequence[Tensor]) -> Iterator[Tensor]:
        """Yield the map (B, C, h, w) of each level, coarse to fine, computed on demand.

        Cells are as many pixels wide as the level's stride and start at the top left corner. The
        part of an image beyond a multiple of 16 pixels is cut off.

        Args:
            blocks: outputs of the encoder's blocks, from the finest stride of the pyramid to 16.
        """
        smooth = dict(zip(self._level_steps, self.smooth, strict=True))
        step = self.lateral[0](blocks[-1])
        for number, lateral in enumerate(self.lateral):
            if number:
                up = functional.interpolate(step, scale_factor=2.0, mode="bilinear")
                height, width = up.shape[-2:]
                step = lateral(blocks[-1 - number][..., :height, :width]) + up
            if number in smooth:
                yield smooth[number](step)
