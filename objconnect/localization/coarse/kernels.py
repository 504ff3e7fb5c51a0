"""Loops over cells that Numba compiles for ``objconnect.localization.coarse.correlation``.

All loops are in this file, because Numba's cache depends on the file.
"""

from __future__ import annotations

from math import floor, sqrt
from typing import Final

import numpy as np
from numba import f4, i4, i8, njit, types
from numpy.typing import NDArray

from objconnect.scene.runtime.loops import INLINED_OPTIONS

Singles = NDArray[np.float32]
SUM_SHIFTED: Final = types.void(
    f4[:, :, ::1], f4[:, ::1], i4[:, :, ::1], f4[:, ::1], i8, f4[:, :, ::1], f4[:, :, ::1]
)
"""Signature of ``sum_shifted``."""
COMPARE: Final = types.void(
    f4[:, :, ::1], f4[:, ::1], f4[:, ::1], f4[:, :, ::1], f4[:, ::1], f4[::1], f4[::1]
)
"""Signature of ``compare``."""
# Cells of the query that are summed for all hypotheses before the next, so that their planes stay
# in the processor's cache.
_BLOCK: Final = 32
_ZERO: Final = np.float32(0)


def sum_shifted(
    planes: Singles,
    known: Singles,
    shifts: NDArray[np.int32],
    weights: Singles,
    every: int,
    sums: Singles,
    overlaps: Singles,
) -> None:
    """Add up shifted planes for each hypothesis.

    Args:
        planes: (N, H, W), one plane for each cell of the query.
        known: (H, W).
        shifts: (T, N, 2) columns and rows by which hypothesis t shifts plane n.
        weights: (T, N).
        every: ``known`` is summed for every n-th cell of the query.
        sums: (T, H, W), to which the weighted planes are added.
        overlaps: (T, H, W), to which ``known``, weighted and shifted alike, is added.
    """
    count, rows, columns = planes.shape
    plane, ground = planes.reshape(-1), known.reshape(-1)
    total, overlap = sums.reshape(-1), overlaps.reshape(-1)
    for block in range(0, count, _BLOCK):
        for t in range(len(shifts)):
            for n in range(block, min(block + _BLOCK, count)):
                weight = weights[t, n]
                column, row = int(shifts[t, n, 0]), int(shifts[t, n, 1])
                first, end = max(0, -column), min(columns, columns - column)
                if weight == _ZERO or end <= first:
                    continue
                for y in range(max(0, -row), min(rows, rows - row)):
                    target = (t * rows + y) * columns + first
                    source = (y + row) * columns + first + column
                    _add(weight, plane, n * rows * columns + source, total, target, end - first)
                    if n % every == 0:
                        _add(weight, ground, source, overlap, target, end - first)


@njit(**INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _add(
    weight: np.float32, values: Singles, source: int, sums: Singles, target: int, count: int
) -> None:
    """Add weighted values from an index on to sums from an index on."""
    # Indices without a sign need no test for negative ones, which would prevent vector
    # instructions.
    first, there = np.uint64(source), np.uint64(target)
    for k in range(np.uint64(count)):
        sums[there + k] += weight * values[first + k]


def compare(
    mosaic: Singles,
    known: Singles,
    features: Singles,
    positions: Singles,
    weights: Singles,
    sums: Singles,
    overlaps: Singles,
) -> None:
    """Compare the cells of the query with the mosaic where poses project them.

    Args:
        mosaic: (H, W, K) features.
        known: (H, W).
        features: (N, K) unit features of the query's cells.
        positions: (P, N, 2) columns and rows, in cells; whole numbers are centres of cells.
        weights: (P, N).
        sums: (P,), to which the weighted cosines are added.
        overlaps: (P,), to which the weighted shares of known ground are added.
    """
    sampled = np.empty(mosaic.shape[2], np.float32)
    for p in range(len(positions)):
        for n in range(len(features)):
            weight = weights[p, n]
            if weight == _ZERO:
                continue
            share = _sample(mosaic, known, positions[p, n, 0], positions[p, n, 1], sampled)
            if share == _ZERO:
                continue
            product, squares = _ZERO, _ZERO
            for k in range(len(sampled)):
                product += sampled[k] * features[n, k]
                squares += sampled[k] * sampled[k]
            if squares > _ZERO:
                sums[p] += weight * share * product / np.float32(sqrt(squares))
            overlaps[p] += weight * share


@njit(**INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _sample(
    mosaic: Singles, known: Singles, x: np.float32, y: np.float32, sampled: Singles
) -> np.float32:
    """Write the features at a position, by bilinear interpolation, and return the share known."""
    rows, columns = known.shape
    sampled[:] = _ZERO
    share = _ZERO
    west, south = floor(x), floor(y)
    for row in range(max(0, int(south)), min(rows, int(south) + 2)):
        for column in range(max(0, int(west)), min(columns, int(west) + 2)):
            part = (np.float32(1) - abs(x - np.float32(column))) * (
                np.float32(1) - abs(y - np.float32(row))
            )
            share += part * known[row, column]
            for k in range(len(sampled)):
                sampled[k] += part * mosaic[row, column, k]
    return share
