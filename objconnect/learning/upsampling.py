"""Compiled bilinear upsampling of integer maps by 2."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, from_numpy

from objconnect.scene.runtime.loops import compile_loop

_SIGNATURE: Final = "void(u1[:,:,:,::1], u1[:,:,:,::1], i2[::1])"


def upsample_integers(maps: Tensor) -> Tensor:
    """Upsample uint8 maps (B, C, h, w) as ``quantization.upsample`` does."""
    cells = maps.permute(0, 2, 3, 1).contiguous().numpy()
    batch, height, width, channels = cells.shape
    out = np.empty((batch, 2 * height, 2 * width, channels), np.uint8)
    # Work space for a row with an additional column at either end.
    row = np.empty((width + 2) * channels, np.int16)
    compile_loop(_upsample, _SIGNATURE)(cells, out, row)
    return from_numpy(out).permute(0, 3, 1, 2)


def _upsample(cells: NDArray[np.uint8], out: NDArray[np.uint8], row: NDArray[np.int16]) -> None:
    """Write cells (B, h, w, C), upsampled, to ``out`` (B, 2 h, 2 w, C)."""
    batch, height, width, channels = cells.shape
    count = np.uint64(channels)
    for item in range(batch):
        for y in range(2 * height):
            # A new cell is 3/4 of the cell that contains it and 1/4 of the nearest other cell.
            containing = y // 2
            other = min(max(containing + (1 if y % 2 else -1), 0), height - 1)
            near, far = cells[item, containing].ravel(), cells[item, other].ravel()
            for k in range(np.uint64(width * channels)):
                row[k + count] = np.int16(3) * np.int16(near[k]) + np.int16(far[k])
            for k in range(count):
                row[k] = row[k + count]
                row[k + np.uint64((width + 1) * channels)] = row[k + np.uint64(width * channels)]
            into = out[item, y].ravel()
            for x in range(width):
                left, middle = np.uint64(x * channels), np.uint64((x + 1) * channels)
                right, first = np.uint64((x + 2) * channels), np.uint64(2 * x * channels)
                for k in range(count):
                    threefold = np.int16(3) * row[middle + k] + np.int16(8)
                    into[first + k] = np.uint8((threefold + row[left + k]) >> 4)
                    into[first + count + k] = np.uint8((threefold + row[right + k]) >> 4)
