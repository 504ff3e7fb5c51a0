"""Layer fusion, which prepares networks for inference.

A convolution, its batch normalisation and its ReLU become one pass. Results are the same up to
rounding. In bfloat16 the convolutions use the processor's matrix or vector units for bfloat16.
"""

from __future__ import annotations

import copy
import platform
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Annotated, Final, Literal

import torch
from pydantic import AfterValidator
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval


def resolve_precision(precision: str) -> str:
    """Return the precision to use on this processor: ``auto`` becomes bfloat16 or float32."""
    if precision != "auto":
        return precision
    return "bfloat16" if has_bfloat16_units() else "float32"


def has_bfloat16_units() -> bool:
    """Return whether the processor computes faster in bfloat16 than in single precision.

    That is the case with matrix units (Intel's AMX) and with AMD's vector units (AVX-512). On
    Intel's vector units, bfloat16 is no faster than single precision.
    """
    if torch.cpu._is_amx_tile_supported():
        return True
    return bool(torch.cpu._is_avx512_bf16_supported()) and processor_maker() == "AuthenticAMD"


@cache
def processor_maker() -> str:
    """Return the vendor string of the processor; empty if unknown."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:  # The system is not Linux. On Windows the vendor is the last part.
        return platform.processor().rpartition(", ")[2]
    return next((line.split()[-1] for line in lines if line.startswith("vendor_id")), "")


Precision = Annotated[Literal["auto", "float32", "bfloat16"], AfterValidator(resolve_precision)]
"""Precision of the convolutions; ``auto`` is resolved in the configuration, so that results record
the precision that was used."""

# oneDNN's convolution fused with a ReLU; None in builds of torch that lack it.
_CONVOLVE_RELU: Final = getattr(torch.ops.mkldnn, "_convolution_pointwise", None)


def _onednn_supports(dtype: torch.dtype) -> bool:
    """Return whether oneDNN supports a type on this processor."""
    return dtype == torch.float32 or torch.ops.mkldnn._is_mkldnn_bf16_supported()


class ConvReLU(nn.Module):
    """A 3x3 convolution fused with a ReLU."""

    def __init__(self, convolution: nn.Conv2d, dtype: torch.dtype) -> None:
        super().__init__()
        copied = copy.deepcopy(convolution).to(dtype).requires_grad_(False)
        # torch's annotations lack this argument.
        copied = copied.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.convolution = copied

    def forward(self, maps: Tensor) -> Tensor:
        """Return the output maps (B, C, h, w)."""
        layer = self.convolution
        maps = maps.to(layer.weight.dtype)
        if _CONVOLVE_RELU is None or maps.device.type != "cpu" or not _onednn_supports(maps.dtype):
            return torch.relu_(layer(maps))
        geometry = (layer.padding, layer.stride, layer.dilation, layer.groups)
        result: Tensor = _CONVOLVE_RELU(maps, layer.weight, layer.bias, *geometry, "relu", [], "")
        return result


class Pooling(nn.Module):
    """Max pooling of 2x2 cells, for integers too.

    torch's layer takes two to three times as long, because it also computes indices.
    """

    def forward(self, maps: Tensor) -> Tensor:
        """Return the pooled maps (B, C, h // 2, w // 2)."""
        height, width = (side // 2 * 2 for side in maps.shape[-2:])
        rows = torch.maximum(maps[..., 0:height:2, :width], maps[..., 1:height:2, :width])
        return torch.maximum(rows[..., 0::2], rows[..., 1::2])


class CellwiseConv(nn.Module):
    """A 1x1 convolution as a matrix product, for channels-last maps."""

    def __init__(self, convolution: nn.Conv2d) -> None:
        super().__init__()
        self.convolution = convolution

    def forward(self, maps: Tensor) -> Tensor:
        """Return the output maps (B, C, h, w), channels-last."""
        layer = self.convolution
        rows = functional.linear(maps.permute(0, 2, 3, 1), layer.weight[:, :, 0, 0], layer.bias)
        return rows.permute(0, 3, 1, 2)


def fuse_layers(network: nn.Module, precision: str) -> None:
    """Fuse the layers of a trained network in place. It can then be neither trained nor saved.

    Args:
        network: network with the parts ``encoder``, ``decoder``, ``features`` and ``confidence``.
        precision: precision of the convolutions of encoder and decoder.
    """
    dtype = torch.bfloat16 if resolve_precision(precision) == "bfloat16" else torch.float32
    for name in ("encoder", "decoder"):
        for module in [*network.get_submodule(name).modules()]:
            if isinstance(module, nn.Sequential):
                layers = [*_fuse([*module], dtype)]
                del module[:]
                module.extend(layers)
    for name in ("features", "confidence"):
        heads = network.get_submodule(name)
        assert isinstance(heads, nn.ModuleList)
        for number, head in enumerate(heads):
            assert isinstance(head, nn.Conv2d)
            heads[number] = CellwiseConv(head.requires_grad_(False))


def _fuse(layers: list[nn.Module], dtype: torch.dtype) -> Iterator[nn.Module]:
    """Yield the layers of a sequence, fused; ``layers`` is emptied."""
    while layers:
        layer = layers.pop(0)
        if isinstance(layer, nn.Conv2d):
            if layers and isinstance(normalisation := layers[0], nn.BatchNorm2d):
                layer = fuse_conv_bn_eval(layer, normalisation)
                del layers[0]
            if layers and isinstance(layers[0], nn.ReLU):
                layers.pop(0)
                layer = ConvReLU(layer, dtype)
        elif isinstance(layer, nn.MaxPool2d):
            assert layer.kernel_size == layer.stride == 2
            layer = Pooling()
        yield layer
