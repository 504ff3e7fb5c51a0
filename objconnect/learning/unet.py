"""The U-Net decoder on VGG16, with maps at several strides, which are computed in strips."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Annotated, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor, nn

from objconnect.learning.quantization import upsample
from objconnect.learning.vgg import channels

STRIDES: Final = (16, 8, 4, 2, 1)
"""Strides of the maps that a decoder can make, px per cell, coarse to fine."""
# Number of rows that are decoded at once: an even number, small enough for the processor's cache.
_ROWS: Final = 64
# Margin of cells that are computed around the needed cells. Interpolating gradients takes two. For
# the next finer level, a level needs half of that level's margin plus one cell of its convolution,
# and one cell for resizing: at most (4 + 1) / 2 + 1 cells.
_MARGIN: Final = 4


def check_levels(strides: Sequence[int], dims: Sequence[int]) -> None:
    """Check the levels of a configuration.

    Raises:
        ValueError: no network on VGG16 has such levels.
    """
    if any(stride not in STRIDES for stride in strides):
        raise ValueError(f"strides must be among {', '.join(map(str, STRIDES))}")
    if any(fine >= coarse for coarse, fine in pairwise(strides)):
        raise ValueError("strides must decrease")
    if len(dims) != len(strides):
        raise ValueError("dims must give one number of channels per stride")


Level = tuple[Tensor, Tensor]
"""Features (B, C, h, w) and confidences (B, 1, h, w) of a level."""
Cellwise = Callable[[Tensor], tuple[Tensor, ...]]
"""A function from maps (B, C, h, w) to several maps (B, _, h, w), cell by cell."""
Channels = Annotated[int, Field(ge=1, le=2048)]
"""Number of channels of a layer; the widest of VGG16 has 512."""


class Decoder(nn.ModuleList):
    """The decoder: steps from stride 16 to finer strides, each with a skip connection.

    Attributes:
        sizes: channels of each level, coarse to fine.
    """

    def __init__(self, width: float, steps: Sequence[int], strides: Sequence[int]) -> None:
        """Build the decoder.

        Args:
            width: channels of the encoder as a share of VGG16's.
            steps: channels of the steps at strides 8, 4, 2 and 1.
            strides: strides of the levels, coarse to fine.
        """
        skips = channels(width)[::-1]
        sizes = [skips[0], *steps[: STRIDES.index(strides[-1])]]
        super().__init__(
            nn.Sequential(
                nn.Conv2d(before + skip, after, 3, padding=1, bias=False),
                nn.BatchNorm2d(after),
                nn.ReLU(inplace=True),
            )
            for (before, after), skip in zip(pairwise(sizes), skips[1:], strict=False)
        )
        self._level_steps = [STRIDES.index(stride) for stride in strides]
        self.sizes = [sizes[step] for step in self._level_steps]

    def forward(self, blocks: Sequence[Tensor]) -> Iterator[Tensor]:
        """Yield the map (B, C, h, w) of each level, coarse to fine, computed on demand.

        Cells are as many pixels wide as the level's stride and start at the top left corner. The
        part of an image beyond a multiple of 16 pixels is cut off.

        Args:
            blocks: outputs of the encoder's blocks, from the finest stride of the decoder to 16.
        """
        for (maps,) in self.levels(blocks, [_identity] * len(self._level_steps)):
            yield maps

    def levels(
        self,
        blocks: Sequence[Tensor],
        heads: Sequence[Cellwise],
        needed: NDArray[np.bool_] | None = None,
    ) -> Iterator[tuple[Tensor, ...]]:
        """Yield the output of each level's head on the map of ``forward``.

        The finest level, the largest, is computed a few rows at a time.

        Args:
            blocks: outputs of the encoder's blocks, as for ``forward``.
            heads: heads of the levels, coarse to fine.
            needed: cells (h, w) of the finest level that are needed; None for all. Cells far from
                them may be zero in the output of any level; cells near them do not change.
        """
        skips = list(blocks)
        del blocks  # so that each block is freed once it is decoded
        finest_spans = _spans(needed)
        decoded = skips.pop()
        if 0 in self._level_steps:
            yield heads[0](decoded)
        for number, step in enumerate(self, 1):
            spans = _coarsen(finest_spans, 2 ** (self._level_steps[-1] - number))
            if number == len(self):
                yield _decode(step, decoded, skips.pop(), heads[-1], spans)
                return
            (decoded,) = _decode(step, decoded, skips.pop(), _identity, spans)
            if number in self._level_steps:
                yield heads[self._level_steps.index(number)](decoded)


def _identity(maps: Tensor) -> tuple[Tensor]:
    return (maps,)


def _spans(needed: NDArray[np.bool_] | None) -> NDArray[np.int64] | None:
    """Return the needed columns (h, 2) of each row: the first, and one past the last.

    They are w and 0 in rows without a needed cell. The result is None, which stands for all cells,
    if ``needed`` is None or has no needed cell.

    Args:
        needed: cells (h, w), or None for all.
    """
    if needed is None or not needed.any():
        return None
    width, has_any = needed.shape[1], needed.any(1)
    first = np.where(has_any, needed.argmax(1), width)
    last = np.where(has_any, width - needed[:, ::-1].argmax(1), 0)
    spans: NDArray[np.int64] = np.stack([first, last], 1)
    return spans


def _coarsen(spans: NDArray[np.int64] | None, times: int) -> NDArray[np.int64] | None:
    """Return the spans of a level whose cells are ``times`` as large."""
    if spans is None:
        return None
    begins = np.arange(0, len(spans), times)
    first = np.minimum.reduceat(spans[:, 0], begins) // times
    last = -(-np.maximum.reduceat(spans[:, 1], begins) // times)
    coarse: NDArray[np.int64] = np.stack([first, last], 1)
    return coarse


class _Window(NamedTuple):
    """The inputs from which a range of cells of a decoded map is computed, along one axis.

    Attributes:
        coarse: cells of the map of half the resolution.
        fine: cells of the encoder's block: the range and, except at the map's border, one more cell
            at either side.
        shift: start of ``fine`` in the coarse cells after resizing.
        margin: start of the range in ``fine``.
    """

    coarse: slice
    fine: slice
    shift: int
    margin: int

    @staticmethod
    def of(first: int, last: int, size: int) -> _Window:
        """Return the inputs of cells ``first`` to ``last``, both even, of ``size`` cells."""
        # The convolution needs one more cell at either side, and the resizing one coarse cell.
        before, after = int(first > 0), int(last < size)
        start = max(first // 2 - 2, 0)
        return _Window(
            coarse=slice(start, last // 2 + 2 * after),
            fine=slice(first - before, last + after),
            shift=first - before - 2 * start,
            margin=before,
        )


def _decode(
    step: nn.Module,
    coarse: Tensor,
    skip: Tensor,
    head: Cellwise,
    spans: NDArray[np.int64] | None = None,
) -> tuple[Tensor, ...]:
    """Apply a step of the decoder and a head.

    They run in strips of rows, because the input of the convolution takes three times the memory of
    the result.

    Args:
        step: the step.
        coarse: maps (B, C, h, w) of the step before, of half the resolution.
        skip: maps of the encoder's block of the same resolution as the result.
        head: the head, which is applied to the result of the step.
        spans: (2 h, 2) needed columns of each row; only columns near them are computed, and the
            others are zero. None for all.
    """
    rows, columns = (2 * side for side in coarse.shape[-2:])
    # In training, batch normalisation needs whole maps.
    count = rows if step.training else _ROWS
    outputs: list[Tensor] = []
    for top in range(0, rows, count):
        bottom, left, right = min(top + count, rows), 0, columns
        if spans is not None:
            near = spans[max(top - _MARGIN, 0) : bottom + _MARGIN]
            left = max(int(near[:, 0].min()) - _MARGIN, 0) // 2 * 2
            right = min((int(near[:, 1].max()) + _MARGIN + 1) // 2 * 2, columns)
            if left >= right:
                continue
        y, x = _Window.of(top, bottom, rows), _Window.of(left, right, columns)
        up = upsample(coarse[..., y.coarse, x.coarse])
        fine = skip[..., :rows, :columns][..., y.fine, x.fine]
        up = up[..., y.shift :, x.shift :][..., : fine.shape[-2], : fine.shape[-1]]
        strip = head(step(torch.cat([up, fine], 1)))
        if strip[0].shape[-2:] == (rows, columns):
            return strip
        outputs = outputs or [_zeros(maps, rows, columns) for maps in strip]
        for maps, part in zip(outputs, strip, strict=True):
            part = part[..., y.margin :, x.margin :]
            maps[..., top:bottom, left:right] = part[..., : bottom - top, : right - left]
    return tuple(outputs)


def _zeros(like: Tensor, rows: int, columns: int) -> Tensor:
    """Return maps of zeros, channels-last in memory, with the channels and type of others."""
    batch, depth = like.shape[:2]
    return like.new_zeros((batch, rows, columns, depth)).permute(0, 3, 1, 2)
