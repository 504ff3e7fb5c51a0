"""8-bit quantization of networks, for processors with VNNI.

Maps between convolutions are integers 0 to 255, weights are -127 to 127 (Jacob et al., CVPR 2018).
Every channel has its own scale, the quantization step. The scale is folded into the weights of the
convolutions before and after the map (Nagel et al., ICCV 2019), so that no map is rescaled. Scales
come from the largest values in calibration pictures; larger values are clipped. Heads are not
quantized.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from objconnect.learning.inference import CellwiseConv, ConvReLU, has_bfloat16_units
from objconnect.learning.vgg import IMAGENET_MEAN, IMAGENET_STD
from objconnect.scene.errors import InputError
from objconnect.scene.runtime.device import supports_loops

NetworkT = TypeVar("NetworkT", bound=nn.Module)
Channelwise = dict[str, Tensor]
"""Values (C,) of the output channels of convolutions, by the name of the module."""


@contextmanager
def largest_values(network: nn.Module) -> Iterator[Channelwise]:
    """Yield the largest values of the channels of a fused network (``inference.fuse_layers``).

    Each forward pass of the network within the context updates them.
    """
    largest: Channelwise = {}

    def watch(name: str, module: ConvReLU) -> torch.utils.hooks.RemovableHandle:
        def observe(_module: nn.Module, _inputs: tuple[Tensor, ...], maps: Tensor) -> None:
            maxima = maps.detach().amax((0, 2, 3)).float()
            largest[name] = torch.maximum(largest.get(name, maxima), maxima)

        return module.register_forward_hook(observe)

    # In training mode the encoder processes whole pictures. In evaluation mode it would process
    # strips, whose borders are padded with zeros.
    encoder = network.get_submodule("encoder").train()
    named = network.named_modules()
    handles = [watch(name, module) for name, module in named if isinstance(module, ConvReLU)]
    try:
        yield largest
    finally:
        encoder.eval()
        for handle in handles:
            handle.remove()


def require_quantizable(network: nn.Module) -> None:
    """Check that ``quantize`` supports a network on this processor.

    Raises:
        InputError: the network is not on the CPU, the CPU has no VNNI, or the network has a decoder
            other than the U-Net, or features that depend on objects.
    """
    if any(each.device.type != "cpu" for each in network.parameters()):
        raise InputError("quantized=true runs on the CPU only: give device=cpu too")
    if not torch.cpu._is_vnni_supported():
        raise InputError("quantized=true needs a processor with VNNI: give quantized=false")
    if not isinstance(network.get_submodule("decoder"), nn.ModuleList):
        raise InputError(
            "quantized=true needs a network with a U-Net decoder: give quantized=false"
        )
    if any(name.startswith("objects_of.") for name, _ in network.named_modules()):
        raise InputError(
            "quantized=true needs a network whose features do not depend on objects: give "
            "quantized=false"
        )


def quantize(network: NetworkT, scales: Channelwise, strides: Sequence[int]) -> NetworkT:
    """Return a copy of a fused network whose convolutions have 8-bit input and output.

    Args:
        network: network with the parts ``encoder``, ``decoder``, ``features`` and ``confidence``.
            The decoder is a list of steps, whose input is the map of the step before and a block of
            the encoder.
        scales: quantization steps (C,) of the output channels of convolutions, by the name of the
            module.
        strides: strides of the levels of the heads.

    Raises:
        InputError: see ``require_quantizable``.
    """
    require_quantizable(network)
    quantized = copy.deepcopy(network)
    blocks = _quantize_encoder(_sequences(quantized.get_submodule("encoder")), scales)
    levels = _quantize_decoder(_sequences(quantized.get_submodule("decoder")), blocks, scales)
    for name in ("features", "confidence"):
        heads = quantized.get_submodule(name)
        assert isinstance(heads, nn.ModuleList)
        for number, (head, stride) in enumerate(zip(heads, strides, strict=True)):
            assert isinstance(head, CellwiseConv)
            # Level 0 has the stride of the encoder's last block, and each further level half the
            # stride of the level before it.
            heads[number] = _Head(head.convolution, levels[len(blocks) - stride.bit_length()])
    return quantized


def _sequences(parts: nn.Module) -> list[nn.Sequential]:
    return [part for part in parts.children() if isinstance(part, nn.Sequential)]


def _quantize_encoder(encoder: Sequence[nn.Sequential], scales: Channelwise) -> list[Tensor]:
    """Replace the layers of an encoder; return the quantization steps of each block's channels."""
    pixels = _QuantizedPixels()
    inputs, zero, blocks = torch.full((3,), pixels.scale), pixels.zero, []
    for number, block in enumerate(encoder):
        for index, layer in enumerate(block):
            if isinstance(layer, ConvReLU):
                outputs = scales[f"encoder.{number}.{index}"]
                block[index] = _QuantizedConvReLU(layer.convolution, inputs, outputs, zero)
                inputs, zero = outputs, 0
        blocks.append(inputs)
    encoder[0].insert(0, pixels)
    return blocks


def _quantize_decoder(
    decoder: Sequence[nn.Sequential], blocks: Sequence[Tensor], scales: Channelwise
) -> list[Tensor]:
    """Replace the layers of a decoder; return the quantization steps of each level's channels."""
    levels = [blocks[-1]]
    for number, step in enumerate(decoder):
        (layer,) = step
        assert isinstance(layer, ConvReLU)
        # Only heads, which are not quantized, read the last map. It is not rounded.
        is_last = number == len(decoder) - 1
        outputs = scales[f"decoder.{number}.0"]
        outputs = torch.ones_like(outputs) if is_last else outputs
        inputs = torch.cat([levels[-1], blocks[-2 - number]])
        step[0] = _QuantizedConvReLU(layer.convolution, inputs, outputs, rounded=not is_last)
        levels.append(outputs)
    return levels


def upsample(maps: Tensor) -> Tensor:
    """Upsample maps (B, C, h, w) bilinearly to (B, C, 2 h, 2 w); integers are rounded."""
    if maps.dtype != torch.uint8:
        return functional.interpolate(maps, scale_factor=2.0, mode="bilinear")
    if supports_loops(maps.device):
        from objconnect.learning.upsampling import upsample_integers

        return upsample_integers(maps)
    # Along either axis, a new cell is 3/4 of the cell that contains it and 1/4 of the nearest other
    # cell.
    wide = maps.permute(0, 2, 3, 1).to(torch.int16)
    for axis, shift, half in ((1, 0, 0), (2, 4, 8)):
        ends = [wide.narrow(axis, 0, 1), wide, wide.narrow(axis, wide.shape[axis] - 1, 1)]
        padded, threefold = torch.cat(ends, axis), 3 * wide + half
        count = wide.shape[axis]
        pair = [(threefold + padded.narrow(axis, first, count)) >> shift for first in (0, 2)]
        wide = torch.stack(pair, axis + 1).flatten(axis, axis + 1)
    return wide.to(torch.uint8).permute(0, 3, 1, 2)


def _heads_type() -> torch.dtype:
    """Return the floating-point type of the heads."""
    return torch.bfloat16 if has_bfloat16_units() else torch.float32


class _QuantizedPixels(nn.Module):
    """Quantizes a normalised picture to 8 bits; a step is about one level of the original picture.

    Attributes:
        scale: quantization step.
        zero: the zero point, the integer that represents 0.
    """

    def __init__(self) -> None:
        super().__init__()
        darkest = min(-mean / std for mean, std in zip(IMAGENET_MEAN, IMAGENET_STD, strict=True))
        brightest = max(
            (1 - mean) / std for mean, std in zip(IMAGENET_MEAN, IMAGENET_STD, strict=True)
        )
        self.scale = (brightest - darkest) / 255
        self.zero = round(-darkest / self.scale)

    def forward(self, maps: Tensor) -> Tensor:
        return (maps / self.scale).round_().add_(self.zero).clamp_(0, 255).to(torch.uint8)


class _QuantizedConvReLU(nn.Module):
    """A 3x3 convolution with a ReLU on integers.

    Args:
        convolution: the convolution in floating point.
        input_steps: (C_in,) quantization steps of the input.
        output_steps: (C_out,) quantization steps of the output.
        zero: the zero point of the input.
        rounded: whether the output is an integer; else it has the type of the heads.
    """

    def __init__(
        self,
        convolution: nn.Conv2d,
        input_steps: Tensor,
        output_steps: Tensor,
        zero: int = 0,
        *,
        rounded: bool = True,
    ) -> None:
        super().__init__()
        weight = convolution.weight.float() * input_steps[None, :, None, None]
        weight = weight / output_steps[:, None, None, None]
        bias = torch.zeros(len(weight)) if convolution.bias is None else convolution.bias.float()
        self._bias, self._zero = bias / output_steps, zero
        self._steps = weight.abs().amax((1, 2, 3)).clamp(min=1e-12) / 127
        self._zeros = torch.zeros(len(weight), dtype=torch.int64)
        sides = (convolution.stride, convolution.padding, convolution.dilation)
        self._geometry: list[Any] = [*map(list, sides), convolution.groups]
        integers = (weight / self._steps[:, None, None, None]).round().to(torch.int8)
        self._weight = torch.ops.onednn.qconv_prepack(
            integers, self._steps, 1.0, zero, *self._geometry, None
        )
        self._type = torch.uint8 if rounded else _heads_type()

    def forward(self, maps: Tensor) -> Tensor:
        weight = (self._weight, self._steps, self._zeros, self._bias)
        result: Tensor = torch.ops.onednn.qconv2d_pointwise(
            maps, 1.0, self._zero, *weight, *self._geometry, 1.0, 0, self._type, "relu", [], ""
        )
        return result


class _Head(CellwiseConv):
    """A head with integer input.

    Args:
        convolution: a 1x1 convolution.
        scale: (C_in,) quantization steps of the input.
    """

    def __init__(self, convolution: nn.Conv2d, scale: Tensor) -> None:
        scaled = copy.deepcopy(convolution).float().requires_grad_(False)
        scaled.weight *= scale[None, :, None, None]
        super().__init__(scaled.to(_heads_type()))

    def forward(self, maps: Tensor) -> Tensor:
        return super().forward(maps.to(self.convolution.weight.dtype))
