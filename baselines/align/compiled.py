"""Projection and the cost of ``baselines.align.residuals`` in compiled loops, for processors.

A point is finished before the next begins, so that its twelve cells are read once, and nothing but
its products is written. Results differ by rounding alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from baselines.align.sampling import CellTable
from scene.geometry.pose import Pose
from scene.geometry.projection import MAX_SLOPE, MIN_DEPTH, Intrinsics, Projection
from scene.runtime.loops import OPTIONS, compiled

_HALF, _ONE = np.float32(0.5), np.float32(1)


def projected(
    cam_from_world: Pose, points: Tensor, camera: Intrinsics
) -> tuple[Tensor, Projection]:
    """Return points of the world in the frames of cameras (M, N, 3), and where these see them.

    Args:
        cam_from_world: (M).
        points: (M, N, 3).
        camera: perspective intrinsics, one or M.

    Returns:
        The points, and what ``Intrinsics.project`` returns with derivatives; pixels of points that
        are not valid are zero.
    """
    shape = points.shape[:-1]
    in_camera, jacobian = np.empty((*shape, 3), np.float32), np.zeros((*shape, 2, 3), np.float32)
    xy, valid = np.zeros((*shape, 2), np.float32), np.zeros(shape, np.bool_)
    cameras = (camera.focal, camera.principal, camera.distortion, camera.limit[..., None])
    compiled(_project, _PROJECT)(
        (*_arrays(cam_from_world.rotation.float(), cam_from_world.translation.float()),),
        *_arrays(points),
        (*_arrays(*(each.reshape(-1, each.shape[-1]) for each in cameras)),),
        (np.float32(MIN_DEPTH), np.float32(MAX_SLOPE)),
        (in_camera, xy, valid, jacobian),
    )
    there, pixels, seen, slopes = map(torch.from_numpy, (in_camera, xy, valid, jacobian))
    return there, Projection(pixels, seen, slopes)


# More than six parameters: they are the fields of ``LevelCost``.
def linearised(
    tables: tuple[CellTable, CellTable | None],
    first: Tensor,
    targets: tuple[Tensor, Tensor | None],
    in_camera: Tensor,
    projection: Projection,
    stride: Tensor,
    border: float,
    scale: float,
) -> tuple[Tensor, ...]:
    """Return what ``Linearisation`` holds of M poses and N points, in the order of its fields.

    Args:
        tables: features, and their confidence or None.
        first: (M,) number of the first cell of each one's map.
        targets: features (M, N, C) of the points, and their confidence (M, N) or None.
        in_camera: points (M, N, 3).
        projection: their pixels, with derivatives; points that are not valid do not count.
        stride: (2,) pixels per cell.
        border: cells at the edge of the map in which points do not count.
        scale: scale of the robust cost.
    """
    assert projection.jacobian is not None
    shape = in_camera.shape[:-1]
    table, trust = tables
    target, target_trust = targets
    # Confidence that is not known is one, and not read.
    one = torch.ones(1, 1)
    seen = np.zeros(shape, np.bool_)
    weight, cost = (np.zeros(shape, np.float32) for _ in range(2))
    pull = np.zeros((*shape, 6), np.float32)
    hessian = np.zeros((len(first), 6, 6), np.float32)
    cells = np.ones((*shape, 2), np.float32)
    compiled(_linearise, _LINEARISE)(
        (
            *_arrays(table.cells, one if trust is None else trust.cells.float(), first),
            table.width,
            table.height,
        ),
        (*_arrays(target, one if target_trust is None else target_trust.float()),),
        (*_arrays(in_camera, projection.xy, projection.valid, projection.jacobian, stride),),
        (np.float32(border), np.float32(2 * scale**2)),
        (trust is not None, target_trust is not None),
        (seen, weight, cost, pull, hessian, cells),
    )
    return tuple(map(torch.from_numpy, (seen, weight, cost, pull, hessian, cells)))


def _arrays(*tensors: Tensor) -> Iterator[NDArray[Any]]:
    return (tensor.contiguous().numpy() for tensor in tensors)


_PROJECT: Final = (
    "void(Tuple((f4[:,:,::1], f4[:,::1])), f4[:,:,::1], UniTuple(f4[:,::1], 4), UniTuple(f4, 2), "
    "Tuple((f4[:,:,::1], f4[:,:,::1], b1[:,::1], f4[:,:,:,::1])))"
)
_LINEARISE: Final = (
    "void(Tuple((f4[:,::1], f4[:,::1], i8[::1], i8, i8)), Tuple((f4[:,:,::1], f4[:,::1])), "
    "Tuple((f4[:,:,::1], f4[:,:,::1], b1[:,::1], f4[:,:,:,::1], f4[::1])), "
    "UniTuple(f4, 2), UniTuple(b1, 2), "
    "Tuple((b1[:,::1], f4[:,::1], f4[:,::1], f4[:,:,::1], f4[:,:,::1], f4[:,:,::1])))"
)
_Numbers = NDArray[np.float32]


def _project(
    cam_from_world: tuple[_Numbers, _Numbers],
    points: _Numbers,
    camera: tuple[_Numbers, _Numbers, _Numbers, _Numbers],
    bounds: tuple[np.float32, np.float32],
    out: tuple[_Numbers, _Numbers, NDArray[np.bool_], _Numbers],
) -> None:
    rotation, translation = cam_from_world
    focal, principal, distortion, limit = camera
    least_depth, most_slope = bounds
    in_camera, xy, valid, jacobian = out
    for pose in range(len(points)):
        turn, shift, k = rotation[pose], translation[pose], pose if len(focal) > 1 else 0
        fx, fy = focal[k]
        k1, k2, p1, p2 = distortion[k]
        for point in range(points.shape[1]):
            px, py, pz = points[pose, point]
            x = turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] * pz + shift[0]
            y = turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] * pz + shift[1]
            z = turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] * pz + shift[2]
            there = in_camera[pose, point]
            there[0], there[1], there[2] = x, y, z
            if not (z > least_depth and max(abs(x), abs(y)) < most_slope * z):
                continue
            u, v = x / z, y / z
            uu, vv, uv2 = u * u, v * v, 2 * u * v
            r2 = uu + vv
            radial = _ONE + r2 * (k1 + k2 * r2)
            slope = 2 * (k1 + 2 * k2 * r2)
            j00 = radial + slope * uu + 2 * p1 * v + 6 * p2 * u
            j11 = radial + slope * vv + 2 * p2 * u + 6 * p1 * v
            j01 = slope * u * v + 2 * p1 * u + 2 * p2 * v
            if not (r2 < limit[k, 0] * limit[k, 0] and j00 * j11 - j01 * j01 > 0):
                continue
            valid[pose, point] = True
            at, by = xy[pose, point], jacobian[pose, point]
            at[0] = fx * (u * radial + p1 * uv2 + p2 * (r2 + 2 * uu)) + principal[k, 0]
            at[1] = fy * (v * radial + p2 * uv2 + p1 * (r2 + 2 * vv)) + principal[k, 1]
            by[0, 0], by[0, 1] = fx * j00 / z, fx * j01 / z
            by[1, 0], by[1, 1] = fy * j01 / z, fy * j11 / z
            by[0, 2] = -(by[0, 0] * u + by[0, 1] * v)
            by[1, 2] = -(by[1, 0] * u + by[1, 1] * v)


def _linearise(
    maps: tuple[_Numbers, _Numbers, NDArray[np.int64], int, int],
    targets: tuple[_Numbers, _Numbers],
    points: tuple[_Numbers, _Numbers, NDArray[np.bool_], _Numbers, _Numbers],
    numbers: tuple[np.float32, np.float32],
    trusted: tuple[bool, bool],
    out: tuple[NDArray[np.bool_], _Numbers, _Numbers, _Numbers, _Numbers, _Numbers],
) -> None:
    features, trust, first, width, height = maps
    target, target_trust = targets
    in_camera, xy, valid, jacobian, stride = points
    border, twice_scale = numbers
    seen, weight, cost, pull, hessian, cells = out
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
            if trusted[0]:
                sure = _bilinear(trust, cell, width, (a, b))
            if trusted[1]:
                sure *= target_trust[pose, point]
            if not sure > 0:
                continue
            _products(features, cell, width, (a, b), target[pose, point], gram)
            for k in range(2):
                _row(in_camera[pose, point], jacobian[pose, point, k], stride[k], rows[k])
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


@njit(inline="always", **OPTIONS)  # type: ignore[untyped-decorator]
def _bilinear(
    table: _Numbers, cell: int, width: int, between: tuple[np.float32, np.float32]
) -> np.float32:
    """Return the value between cells of a table of one channel."""
    (a, b), below = between, cell + width
    above = (_ONE - a) * table[cell, 0] + a * table[cell + 1, 0]
    value: np.float32 = (_ONE - b) * above
    value += b * ((_ONE - a) * table[below, 0] + a * table[below + 1, 0])
    return value


@njit(inline="always", **OPTIONS)  # type: ignore[untyped-decorator]
def _row(point: _Numbers, slope: _Numbers, stride: np.float32, row: _Numbers) -> None:
    """Write the derivative of a pixel's coordinate, in cells, by the tangent of the pose."""
    (x, y, z), (of_x, of_y, of_z) = point, slope
    row[0], row[3] = (y * of_z - z * of_y) / stride, of_x / stride
    row[1], row[4] = (z * of_x - x * of_z) / stride, of_y / stride
    row[2], row[5] = (x * of_y - y * of_x) / stride, of_z / stride


@njit(inline="always", **OPTIONS)  # type: ignore[untyped-decorator]
def _products(
    features: _Numbers,
    cell: int,
    width: int,
    between: tuple[np.float32, np.float32],
    target: _Numbers,
    out: _Numbers,
) -> None:
    """Sum the products of residual and slopes over the channels: rr, rx, ry, xx, xy, yy.

    The value is bilinear ``between`` cells, the slopes are its central differences.
    """
    a, b = between
    a1, b1 = _ONE - a, _ONE - b
    second = cell + width
    # In maps of three cells there is no cell before the first one.
    over_left, over_right = features[max(cell - width, 0)], features[max(cell - width + 1, 0)]
    before_top, top_left = features[max(cell - 1, 0)], features[cell]
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
