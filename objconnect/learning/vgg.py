"""The convolutions of VGG16 and VGG19 (Simonyan and Zisserman, ICLR 2015), of any width."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn

# Channels of the convolutions of each block of VGG16. Between blocks there is a pooling by 2.
BLOCKS: Final = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))
# ImageNet's mean and standard deviation of RGB in 0..1, by which the input is normalised.
IMAGENET_MEAN: Final = (0.485, 0.456, 0.406)
IMAGENET_STD: Final = (0.229, 0.224, 0.225)
# Number of rows of a strip in the first block, an even number. Smaller strips take more time.
_ROWS: Final = 128
# Number of additional rows at either side that the block's two convolutions need.
_HALO: Final = 2


def channels(width: float) -> list[int]:
    """Return the output channels of the five blocks; ``width`` is a share of VGG16's."""
    return [round(block[-1] * width) for block in BLOCKS]


def vgg16_blocks(width: float = 1.0, extra: int = 0) -> list[list[nn.Module]]:
    """Return the five blocks, each a list of 3x3 convolutions with ReLUs, without the poolings.

    With poolings between them, the order of layers is that of torchvision's ``vgg16().features``,
    so that its weights can be loaded by position.

    Args:
        width: number of channels as a share of VGG16's.
        extra: number of additional convolutions in each of the last three blocks; 1 makes VGG19.
    """
    blocks: list[list[nn.Module]] = []
    previous = 3
    for position, sizes in enumerate(BLOCKS):
        block: list[nn.Module] = []
        for size in (*sizes, *sizes[:1] * extra) if position >= 2 else sizes:
            out = round(size * width)
            block += [nn.Conv2d(previous, out, 3, padding=1), nn.ReLU(inplace=True)]
            previous = out
        blocks.append(block)
    return blocks


def vgg16_encoder(width: float = 1.0, extra: int = 0) -> nn.ModuleList:
    """Return the blocks of ``vgg16_blocks`` as modules. All but the first begin with a pooling.

    Parameters are named ``BLOCK.LAYER``, as in PixLoc's encoder.
    """
    return nn.ModuleList(
        nn.Sequential(*([nn.MaxPool2d(2)] if position else []), *block)
        for position, block in enumerate(vgg16_blocks(width, extra))
    )


def encode(encoder: nn.ModuleList, image: Tensor, finest: int = 1) -> list[Tensor]:
    """Return the outputs of the encoder's blocks, fine to coarse, strides ``finest`` to 16.

    Args:
        encoder: result of ``vgg16_encoder``.
        image: images (B, 3, H, W), RGB, in 0..1 or of bytes. They are normalised here by
            ImageNet's mean and standard deviation.
        finest: finest stride of the outputs. The output at stride 1 takes most of the memory.
    """
    first, second = encoder[0], encoder[1]
    assert isinstance(second, nn.Sequential)
    pooling, others = second[0], second[1:]
    blocks = []
    if finest > 1 and not encoder.training:
        maps = _run_in_strips(nn.Sequential(first, pooling), image)
    else:
        maps = first(_normalise(image))
        if finest == 1:
            blocks.append(maps)
        maps = pooling(maps)
    for number, block in enumerate([others, *encoder[2:]], 1):
        maps = block(maps)
        if 2**number >= finest:
            blocks.append(maps)
    return blocks


def scale_to_unit(image: Tensor) -> Tensor:
    """Return images in 0..1, converted from bytes if necessary."""
    return image / 255 if image.dtype == torch.uint8 else image


def _normalise(image: Tensor) -> Tensor:
    image = scale_to_unit(image)
    mean, std = image.new_tensor([IMAGENET_MEAN, IMAGENET_STD])[..., None, None]
    return torch.addcmul(-mean / std, image, 1 / std)  # in one pass


def _run_in_strips(layers: nn.Module, image: Tensor) -> Tensor:
    """Apply the first block and its pooling to an image in strips of rows.

    The full maps of the block would take several times the memory of the result. All strips have
    the same height, because oneDNN compiles a convolution for each size.
    """
    height = image.shape[-2]
    # Strips begin at even rows, because each even row is pooled with the row after it.
    count = min(_ROWS + 2 * _HALO + height % 2, height)
    pooled: Tensor | None = None
    done = 0
    while done < height // 2:
        begin = min(max(2 * done - _HALO, 0), height - count)
        end = begin + count
        last = height // 2 if end == height else (end - _HALO) // 2
        strip = layers(_normalise(image[..., begin:end, :]))
        if pooled is None:
            batch, depth, _, width = strip.shape
            pooled = strip.new_empty((batch, height // 2, width, depth)).permute(0, 3, 1, 2)
        pooled[..., done:last, :] = strip[..., done - begin // 2 : last - begin // 2, :]
        done = last
    assert pooled is not None
    return pooled


def initialise_convolutions(network: nn.Module) -> None:
    """Initialise convolutions larger than 1x1 so that ReLUs keep the variance (He et al., 2015)."""
    for module in network.modules():
        if isinstance(module, nn.Conv2d) and module.kernel_size != (1, 1):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
            if module.bias is not None:
                nn.init.zeros_(module.bias)
