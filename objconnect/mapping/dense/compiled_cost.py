"""The plane cost of ``objconnect.mapping.dense.photometry`` in compiled loops for CPUs.

Each pixel is computed completely before the next, so that only its cost is written, and remaining
sources are skipped as soon as a plane cannot become the best. Results equal those of
``Photometry`` up to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from objconnect.mapping.dense.photometry import (
    GEOMETRIC_LIMIT_PX,
    GEOMETRIC_WEIGHT,
    NOISE_VARIANCE,
    SIGMA_GREY,
    SIGMA_PX,
    STEPS,
    WORST_COST,
    Visibility,
)
from objconnect.mapping.dense.warp import MIN_DEPTH_RATIO, StereoView, Warp
from objconnect.scene.runtime.loops import LOOP_OPTIONS

_F = np.float32
# Offsets (S,) of the samples around a pixel. Compiled code takes them as constants.
_DX = np.tile(np.array(STEPS, np.float32), len(STEPS))
_DY = np.repeat(np.array(STEPS, np.float32), len(STEPS))
_SAMPLES = len(_DX)
# Padding of sources: one row, so that every pixel has a row below it, and these columns, because
# rows whose length is a power of two would make windows of several sources compete for the same
# cache lines.
_PADDING = 17
_ZERO, _HALF, _ONE = _F(0), _F(0.5), _F(1)
_NOISE, _WORST, _MIN_DEPTH = _F(NOISE_VARIANCE), _F(WORST_COST), _F(MIN_DEPTH_RATIO)
# The options keep infinities valid, because costs may be infinite.
_compiled = njit(**LOOP_OPTIONS)


class CompiledWindow(NamedTuple):
    """Windows around n pixels of the reference view, S samples each.

    Attributes:
        rows: row (n,) of the pixel.
        columns: column (n,) of the pixel.
        weights: weights (n, S) of the samples, which sum to one.
        correlators: factors (n, S), see ``objconnect.mapping.dense.photometry.Samples``.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    weights: NDArray[np.float32]
    correlators: NDArray[np.float32]

    def part(self, index: slice) -> CompiledWindow:
        """Return the windows around the pixels of a slice."""
        return CompiledWindow(
            self.rows[index], self.columns[index], self.weights[index], self.correlators[index]
        )


class _Sources(NamedTuple):
    """K sources as arrays for compiled code.

    Attributes:
        seen: whether a source shows a pixel, (K, H, W), see ``Visibility``.
        num_counted: number of sources that a cost averages, (H, W), see ``Visibility``.
        grey: pixels of all pictures, see ``_concatenate``.
        inverse_depths: inverse depth maps of all sources in the same layout; empty without maps.
        begins: start of each picture in these arrays, (K,).
        shapes: height and width of each picture, (K, 2).
        to_sources: warps to the sources, (K, 3, 4).
        from_sources: warps from the sources, (K, 3, 4).
        geometric_weight: ``GEOMETRIC_WEIGHT``.
        limit_px: ``GEOMETRIC_LIMIT_PX``.
    """

    seen: NDArray[np.bool_]
    num_counted: NDArray[np.int64]
    grey: NDArray[np.float32]
    inverse_depths: NDArray[np.float32]
    begins: NDArray[np.int64]
    shapes: NDArray[np.int64]
    to_sources: NDArray[np.float32]
    from_sources: NDArray[np.float32]
    geometric_weight: np.float32
    limit_px: np.float32


class _Projection(NamedTuple):
    """A pixel in another picture: column, row, depth ratio, and whether it is inside."""

    u: np.float32
    v: np.float32
    z: np.float32
    inside: bool


class _Slopes(NamedTuple):
    """Derivatives of a projection: du/dx, du/dy, dv/dx and dv/dy."""

    ux: np.float32
    uy: np.float32
    vx: np.float32
    vy: np.float32


class CompiledPhotometry:
    """Costs of planes at pixels; arguments and results as ``Photometry``."""

    def __init__(
        self,
        reference: StereoView,
        sources: Sequence[StereoView],
        expected: Tensor,
        inverse_depths: Sequence[Tensor] | None = None,
    ) -> None:
        # The remaining work of torch is too small to benefit from several threads.
        self.torch_threads = 1
        self._threads = torch.get_num_threads()
        self._pool = ThreadPoolExecutor(self._threads)
        self._padded = np.pad(reference.grey.numpy(), STEPS[-1], mode="edge")
        self._near = np.exp(-(_DX**2 + _DY**2) / _F(2 * SIGMA_PX**2))
        self._sigma_grey = _F(SIGMA_GREY)
        to_sources = [Warp.between(reference, source) for source in sources]
        visible = Visibility.of(reference, to_sources, expected)
        shapes = np.array([source.grey.shape for source in sources])
        sizes = (shapes + np.array([1, _PADDING])).prod(1)
        self._sources = _Sources(
            visible.seen.numpy(),
            visible.num_counted.numpy(),
            _concatenate([source.grey for source in sources]),
            _concatenate(inverse_depths or ()),
            np.cumsum(sizes) - sizes,
            shapes,
            _matrices(to_sources),
            _matrices([Warp.between(source, reference) for source in sources]),
            _F(GEOMETRIC_WEIGHT),
            _F(GEOMETRIC_LIMIT_PX),
        )

    def window(self, rows: Tensor, columns: Tensor) -> CompiledWindow:
        """Return the windows around pixels (n,) of the reference."""
        weights = np.empty((len(rows), _SAMPLES), np.float32)
        window = CompiledWindow(rows.numpy(), columns.numpy(), weights, np.empty_like(weights))

        def fill(part: slice) -> None:
            _fill_windows(window.part(part), self._padded, self._near, self._sigma_grey)

        self._run_in_parts(fill, len(rows))
        return window

    def cost(self, window: CompiledWindow, planes: Tensor, bounds: Tensor | None = None) -> Tensor:
        """Return the cost of a plane at each pixel; see ``PlaneCosts``."""
        costs = torch.empty(planes.shape[1:])
        values, out = planes.contiguous().numpy(), costs.numpy()
        upper = np.full(len(out), np.inf, np.float32) if bounds is None else bounds.numpy()

        def fill(part: slice) -> None:
            _fill_costs(window.part(part), values[:, part], upper[part], self._sources, out[part])

        self._run_in_parts(fill, len(out))
        return costs

    def _run_in_parts(self, fill: Callable[[slice], None], count: int) -> None:
        """Split a range into as many parts as torch has threads, and call ``fill`` in parallel."""
        ends = np.linspace(0, count, self._threads + 1).astype(int)
        parts = [slice(begin, end) for begin, end in pairwise(ends)]
        if len(parts) == 1:
            fill(parts[0])
        else:
            list(self._pool.map(fill, parts))


def _matrices(warps: Sequence[Warp]) -> NDArray[np.float32]:
    """Return rotations and translations (K, 3, 4) of warps."""
    return np.array([np.column_stack([w.rotation, w.translation]) for w in warps], np.float32)


def _concatenate(pictures: Sequence[Tensor]) -> NDArray[np.float32]:
    """Return the pixels of pictures of several sizes as one array, padded by ``_PADDING``."""
    padded = (np.pad(each.numpy(), ((0, 1), (0, _PADDING)), mode="edge") for each in pictures)
    return np.concatenate([np.empty(0, np.float32), *(each.ravel() for each in padded)])


@_compiled
def _fill_windows(window, padded, near, sigma_grey):  # type: ignore[no-untyped-def]
    """Write the weights and correlators of the windows around pixels."""
    reach = STEPS[-1]
    weights, correlators = window.weights, window.correlators
    for i in range(len(window.rows)):
        row, column = window.rows[i] + reach, window.columns[i] + reach
        middle = padded[row, column]
        total = mean = _ZERO
        for s in range(_SAMPLES):
            grey = padded[row + int(_DY[s]), column + int(_DX[s])]
            weight = near[s] * np.exp(-abs(grey - middle) / sigma_grey)
            weights[i, s] = weight
            correlators[i, s] = grey
            total += weight
            mean += weight * grey
        mean /= total
        variance = _ZERO
        for s in range(_SAMPLES):
            weights[i, s] /= total
            central = correlators[i, s] - mean
            variance += weights[i, s] * central * central
            correlators[i, s] = weights[i, s] * central
        deviation = np.sqrt(variance + _NOISE)
        for s in range(_SAMPLES):
            correlators[i, s] /= deviation


@_compiled
def _fill_costs(window, planes, bounds, sources, costs):  # type: ignore[no-untyped-def]
    """Write the cost (n,) of a plane at each pixel; ``bounds`` as in ``PlaneCosts.cost``."""
    (
        seen,
        num_counted,
        grey,
        inverse_depths,
        begins,
        shapes,
        to_sources,
        from_sources,
        geometric_weight,
        limit_px,
    ) = sources
    rows, columns, weights, correlators = window
    costs_so_far = np.empty(len(seen), np.float32)
    for i in range(len(rows)):
        row, column = rows[i], columns[i]
        x, y = _F(column) + _HALF, _F(row) + _HALF
        w, gx, gy = planes[0, i], planes[1, i], planes[2, i]
        needed, remaining = num_counted[row, column], 0
        for k in range(len(seen)):
            remaining += seen[k, row, column]
        done, cost = 0, _WORST
        for k in range(len(seen)):
            if not seen[k, row, column]:
                continue
            shape = (shapes[k, 0], shapes[k, 1])
            begin, source_cost = begins[k], _WORST
            at = _warp(to_sources, k, shape, x, y, w)
            if at.inside:
                slopes = _slopes(to_sources, k, at, gx, gy)
                source_cost = _ONE - _correlation(
                    grey, begin, shape, at, slopes, weights, correlators, i
                )
                if len(inverse_depths):
                    pixel = begin + int(at.v) * (shape[1] + _PADDING) + int(at.u)
                    known, error_px = inverse_depths[pixel], limit_px
                    if known > 0:
                        returned = _warp(from_sources, k, shape, at.u, at.v, known)
                        error_px = min(np.hypot(returned.u - x, returned.v - y), error_px)
                    source_cost += geometric_weight * error_px
            # Insert the cost in ascending order.
            rank = done
            while rank > 0 and costs_so_far[rank - 1] > source_cost:
                costs_so_far[rank] = costs_so_far[rank - 1]
                rank -= 1
            costs_so_far[rank] = source_cost
            done += 1
            remaining -= 1
            # Lower bound of the cost, if the remaining sources cost nothing.
            cost = _ZERO
            for j in range(needed - remaining):
                cost += costs_so_far[j]
            cost /= _F(needed)
            if cost >= bounds[i]:
                break
        costs[i] = cost


@_compiled
def _warp(matrices, k, shape, x, y, w):  # type: ignore[no-untyped-def]
    """Warp a pixel by warp k into a picture of a shape, as ``Warp`` does."""
    a = matrices[k, 0, 0] * x + matrices[k, 0, 1] * y + (matrices[k, 0, 2] + matrices[k, 0, 3] * w)
    b = matrices[k, 1, 0] * x + matrices[k, 1, 1] * y + (matrices[k, 1, 2] + matrices[k, 1, 3] * w)
    c = matrices[k, 2, 0] * x + matrices[k, 2, 1] * y + (matrices[k, 2, 2] + matrices[k, 2, 3] * w)
    z = max(c, _MIN_DEPTH)
    u, v = a / z, b / z
    inside = u > 0 and u < shape[1] and v > 0 and v < shape[0] and c > _MIN_DEPTH
    return _Projection(u, v, z, inside)


@_compiled
def _slopes(matrices, k, at, gx, gy):  # type: ignore[no-untyped-def]
    """Return the slopes of warp k as ``Warp.slopes`` does."""
    u, v, z = at.u, at.v, at.z
    zx = matrices[k, 2, 0] + matrices[k, 2, 3] * gx
    zy = matrices[k, 2, 1] + matrices[k, 2, 3] * gy
    return _Slopes(
        (matrices[k, 0, 0] + matrices[k, 0, 3] * gx - u * zx) / z,
        (matrices[k, 0, 1] + matrices[k, 0, 3] * gy - u * zy) / z,
        (matrices[k, 1, 0] + matrices[k, 1, 3] * gx - v * zx) / z,
        (matrices[k, 1, 1] + matrices[k, 1, 3] * gy - v * zy) / z,
    )


@_compiled
# More than six parameters: packing arrays into a tuple takes half as long as the sum itself.
def _correlation(grey, begin, shape, at, slopes, weights, correlators, i):  # type: ignore[no-untyped-def]
    """Return the weighted correlation of window i with the window around a projection."""
    right, bottom, stride = _F(shape[1] - 1), _F(shape[0] - 1), np.uint32(shape[1] + _PADDING)
    # Positions are relative to the centre of the first pixel and are clamped to the edge.
    u, v = at.u - _HALF, at.v - _HALF
    mean = square = product = _ZERO
    for s in range(_SAMPLES):
        column = u + slopes.ux * _DX[s] + slopes.uy * _DY[s]
        row = v + slopes.vx * _DX[s] + slopes.vy * _DY[s]
        column = column if column > _ZERO else _ZERO
        column = column if column < right else right
        row = row if row > _ZERO else _ZERO
        row = row if row < bottom else bottom
        left, top = np.int32(column), np.int32(row)
        across, down = column - _F(left), row - _F(top)
        # Unsigned indices avoid the test for negative ones.
        pixel = np.uint32(begin) + np.uint32(top) * stride + np.uint32(left)
        under = pixel + stride
        upper = grey[pixel] + across * (grey[pixel + np.uint32(1)] - grey[pixel])
        lower = grey[under] + across * (grey[under + np.uint32(1)] - grey[under])
        value = upper + down * (lower - upper)
        weighted = weights[i, s] * value
        mean += weighted
        square += weighted * value
        product += correlators[i, s] * value
    variance = max(square - mean * mean, _ZERO) + _NOISE
    return min(max(product / np.sqrt(variance), -_ONE), _ONE)
