"""The linearised cost of ``baselines.align.residuals`` in compiled loops, for processors.

A point is finished before the next begins, so that its twelve cells are read once, and nothing but
its products is written. Results differ by rounding alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, Final

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from scene.geometry.projection import Projection

_HALF, _ONE = np.float32(0.5), np.float32(1)
_OPTIONS: Final[dict[str, Any]] = {
    "nogil": True,
    "error_model": "numpy",
    # What is not finite must stay so: flags that exclude it are missing.
    "fastmath": {"contract", "reassoc", "arcp", "nsz"},
}
_plain = njit(**_OPTIONS)


def linearised(
    tables: tuple[Tensor, Tensor | None],
    size: tuple[int, int],
    first: Tensor,
    targets: tuple[Tensor, Tensor | None],
    in_camera: Tensor,
    projected: Projection,
    mask: Tensor,
    stride: Tensor,
    border: float,
    scale: float,
) -> tuple[Tensor, ...]:
    """Return what ``Linearisation`` holds of M poses and N points, in the order of its fields.

    Args:
        tables: cells (T, C) of features, and their confidence (T, 1) or None.
        size: width and height of a map.
        first: (M,) number of the first cell of each one's map.
        targets: features (M, N, C) of the points, and their confidence (M, N) or None.
        in_camera: points (M, N, 3).
        projected: their pixels, with derivatives.
        mask: (M, N) points to use.
        stride: (2,) pixels per cell.
        border: cells at the edge of the map in which points do not count.
        scale: scale of the robust cost.
    """
    assert projected.jacobian is not None
    poses, points = mask.shape
    features, trust = tables
    target, target_trust = targets
    # Confidence that is not known is one: a table of one cell, and no points.
    one = torch.ones(1, 1)
    seen = np.zeros((poses, points), np.bool_)
    weight, cost = (np.zeros((poses, points), np.float32) for _ in range(2))
    pull = np.zeros((poses, points, 6), np.float32)
    hessian = np.zeros((poses, 6, 6), np.float32)
    cells = np.ones((poses, points, 2), np.float32)
    _compiled()(
        *_arrays(features, one if trust is None else trust.float()),
        np.array(size),
        *_arrays(first, target, one if target_trust is None else target_trust.float()),
        *_arrays(in_camera, projected.xy, projected.valid & mask, projected.jacobian, stride),
        np.float32(border),
        np.float32(2 * scale**2),
        trust is not None,
        target_trust is not None,
        (seen, weight, cost, pull, hessian, cells),
    )
    return tuple(map(torch.from_numpy, (seen, weight, cost, pull, hessian, cells)))


def _arrays(*tensors: Tensor) -> Iterator[NDArray[Any]]:
    return (tensor.contiguous().numpy() for tensor in tensors)


@cache
def _compiled() -> Callable[..., None]:
    """Return the compiled loops, which are kept beside this file or in the user's cache.

    To compile them takes more than a second, to read them a tenth of one.
    """
    try:
        made = njit(cache=True, **_OPTIONS)(_linearise)
        made.compile(_SIGNATURE)
    except (OSError, RuntimeError):  # nowhere to keep them, or the disk is full
        made = _plain(_linearise)
        made.compile(_SIGNATURE)
    loops: Callable[..., None] = made
    return loops


_SIGNATURE: Final = (
    "void(f4[:,::1], f4[:,::1], i8[::1], i8[::1], f4[:,:,::1], f4[:,::1], f4[:,:,::1], "
    "f4[:,:,::1], b1[:,::1], f4[:,:,:,::1], f4[::1], f4, f4, b1, b1, "
    "Tuple((b1[:,::1], f4[:,::1], f4[:,::1], f4[:,:,::1], f4[:,:,::1], f4[:,:,::1])))"
)
_Numbers = NDArray[np.float32]


def _linearise(
    features: _Numbers,
    trust: _Numbers,
    size: NDArray[np.int64],
    first: NDArray[np.int64],
    target: _Numbers,
    target_trust: _Numbers,
    in_camera: _Numbers,
    xy: _Numbers,
    valid: NDArray[np.bool_],
    jacobian: _Numbers,
    stride: _Numbers,
    border: np.float32,
    twice_scale: np.float32,
    has_trust: bool,
    has_target_trust: bool,
    out: tuple[NDArray[np.bool_], _Numbers, _Numbers, _Numbers, _Numbers, _Numbers],
) -> None:
    seen, weight, cost, pull, hessian, cells = out
    width, height = size[0], size[1]
    last_x, last_y = np.float32(width - 1) - border, np.float32(height - 1) - border
    rows = np.empty((2, 6), np.float32)
    gram = np.empty(6, np.float32)
    for pose in range(len(valid)):
        for point in range(valid.shape[1]):
            if not valid[pose, point]:
                continue
            x = xy[pose, point, 0] / stride[0] - _HALF
            y = xy[pose, point, 1] / stride[1] - _HALF
            if not (border <= x <= last_x and border <= y <= last_y):
                continue
            cells[pose, point, 0], cells[pose, point, 1] = x, y
            left = min(max(int(x), 1), width - 3)
            top = min(max(int(y), 1), height - 3)
            a, b = x - np.float32(left), y - np.float32(top)
            cell = first[pose] + top * width + left
            sure = _ONE
            if has_trust:
                sure = (_ONE - b) * ((_ONE - a) * trust[cell, 0] + a * trust[cell + 1, 0])
                below = cell + width
                sure += b * ((_ONE - a) * trust[below, 0] + a * trust[below + 1, 0])
            if has_target_trust:
                sure *= target_trust[pose, point]
            if not sure > 0:
                continue
            _products(features, cell, width, a, b, target[pose, point], gram)
            for k in range(2):
                of_x, of_y, of_z = jacobian[pose, point, k]
                px, py, pz = in_camera[pose, point]
                rows[k, 0] = (py * of_z - pz * of_y) / stride[k]
                rows[k, 1] = (pz * of_x - px * of_z) / stride[k]
                rows[k, 2] = (px * of_y - py * of_x) / stride[k]
                rows[k, 3] = of_x / stride[k]
                rows[k, 4] = of_y / stride[k]
                rows[k, 5] = of_z / stride[k]
            share = sure / (_ONE + gram[0] / twice_scale)
            seen[pose, point], weight[pose, point] = True, sure
            cost[pose, point] = twice_scale * np.log1p(gram[0] / twice_scale)
            gx, gy = share * gram[1], share * gram[2]
            gxx, gxy, gyy = share * gram[3], share * gram[4], share * gram[5]
            for i in range(6):
                along_x, along_y = rows[0, i], rows[1, i]
                pull[pose, point, i] = gx * along_x + gy * along_y
                both_x, both_y = gxx * along_x + gxy * along_y, gxy * along_x + gyy * along_y
                for j in range(6):
                    hessian[pose, i, j] += both_x * rows[0, j] + both_y * rows[1, j]


@njit(inline="always", **_OPTIONS)  # type: ignore[untyped-decorator]
def _products(
    features: _Numbers,
    cell: int,
    width: int,
    a: np.float32,
    b: np.float32,
    target: _Numbers,
    out: _Numbers,
) -> None:
    """Sum the products of residual and slopes over the channels: rr, rx, ry, xx, xy, yy.

    The value is bilinear at ``a``, ``b`` between cells, the slopes are its central differences.
    """
    a1, b1 = _ONE - a, _ONE - b
    first, second = cell - width, cell + width
    over_left, over_right = features[first], features[first + 1]
    before_top, top_left = features[cell - 1], features[cell]
    top_right, after_top = features[cell + 1], features[cell + 2]
    before_low, low_left = features[second - 1], features[second]
    low_right, after_low = features[second + 1], features[second + 2]
    under_left, under_right = features[second + width], features[second + width + 1]
    rr = rx = ry = xx = xy = yy = np.float32(0)
    # A signed number would be tested for being negative, and cells gathered one by one.
    for c in range(np.uint64(len(target))):
        # Columns and rows through the point, of which slopes are differences.
        left = b1 * top_left[c] + b * low_left[c]
        right = b1 * top_right[c] + b * low_right[c]
        before = b1 * before_top[c] + b * before_low[c]
        after = b1 * after_top[c] + b * after_low[c]
        top = a1 * top_left[c] + a * top_right[c]
        low = a1 * low_left[c] + a * low_right[c]
        over = a1 * over_left[c] + a * over_right[c]
        under = a1 * under_left[c] + a * under_right[c]
        residual = b1 * top + b * low - target[c]
        slope_x = _HALF * (a1 * (right - before) + a * (after - left))
        slope_y = _HALF * (b1 * (low - over) + b * (under - top))
        rr += residual * residual
        rx += residual * slope_x
        ry += residual * slope_y
        xx += slope_x * slope_x
        xy += slope_x * slope_y
        yy += slope_y * slope_y
    out[0], out[1], out[2], out[3], out[4], out[5] = rr, rx, ry, xx, xy, yy
