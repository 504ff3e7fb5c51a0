"""Loops over points that Numba compiles for ``objconnect.localization.align.compiled_loops``.

Each point is processed as a whole: its twelve cells are read once, and only products of residuals
and slopes are written. All loops are in this file, because Numba's cache depends on the file.
"""

from __future__ import annotations

from math import isfinite, sin, sqrt

import numpy as np
from numba import njit

from objconnect.localization.align.records import (
    Around,
    Doubles,
    Level,
    Moving,
    Points,
    PoseArrays,
    Rules,
    Singles,
    View,
)
from objconnect.scene.runtime.loops import CALLED

_HALF, _ONE = np.float32(0.5), np.float32(1)
# Coefficients of a lens without a denominator.
_POLYNOMIAL = 4


def descend(
    level: Level, points: Points, moving: Moving, rules: Rules, first: int, end: int
) -> None:
    """Minimise the cost of poses ``first`` to ``end``.

    Args:
        level: features of queries and points.
        points: points and cameras.
        moving: the poses and the output arrays.
        rules: options of the minimisation.
        first: number of the first pose.
        end: number after the last.
    """
    poses, out = moving.poses, moving.around
    tried, factors = moving.tried, moving.factors
    number = points.xyz.shape[1]
    view = View(
        np.empty((number, 3), np.float32),
        np.empty((number, 2), np.float32),
        np.empty(number, np.bool_),
        np.empty((number, 2, 3), np.float32),
    )
    there = Around(
        np.empty(number, np.bool_),
        np.empty(number, np.float32),
        np.empty(number, np.float32),
        np.empty((number, 6), np.float32),
        np.empty((6, 6), np.float32),
        np.empty((number, 2), np.float32),
    )
    trial = PoseArrays(np.empty((3, 3)), np.empty(3))
    gradient, step = np.empty(6), np.empty(6)
    for k in range(first, end):
        pose = PoseArrays(poses.turn[k], poses.shift[k])
        here = Around(
            out.seen[k], out.weight[k], out.cost[k], out.pull[k], out.hessian[k], out.cells[k]
        )
        step[:] = 0
        tried[k], factors[k], ended = -1, 1.0, not moving.alive[k]
        while True:
            angle, length = _move(pose, step, trial)
            _project(trial, points, k, view)
            _linearise(level, k, view, there)
            tried[k] += 1
            better = tried[k] == 0 or _falls(here, there, rules.min_points)
            if better:
                _accept(trial, there, pose, here)
            if tried[k] > 0:
                ended = angle < rules.small_turn and length < rules.small_shift
                factor = factors[k] / rules.change if better else factors[k] * rules.change
                factors[k] = min(max(factor, rules.least), rules.most)
            if ended or tried[k] == rules.steps or not _gradient(here, rules.min_points, gradient):
                break
            _solve_step(gradient, here.hessian, factors[k] * rules.damping, rules.floor, step)


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _accept(found: PoseArrays, there: Around, pose: PoseArrays, here: Around) -> None:
    """Copy a pose and the cost around it."""
    for row in range(3):
        pose.shift[row] = found.shift[row]
        for column in range(3):
            pose.turn[row, column] = found.turn[row, column]
    for row in range(6):
        for column in range(6):
            here.hessian[row, column] = there.hessian[row, column]
    for point in range(len(here.seen)):
        here.seen[point], here.weight[point] = there.seen[point], there.weight[point]
        here.cost[point] = there.cost[point]
        for k in range(6):
            here.pull[point, k] = there.pull[point, k]
        for k in range(2):
            here.cells[point, k] = there.cells[point, k]


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _gradient(around: Around, min_points: int, out: Doubles) -> bool:
    """Write the gradient (6,), and return whether a step can be computed."""
    finite, count = True, 0
    for k in range(6):
        out[k] = 0
    for point in range(len(around.seen)):
        count += around.seen[point]
        for k in range(6):
            out[k] += around.pull[point, k]
    for row in range(6):
        finite &= isfinite(out[row])
        for column in range(6):
            finite &= isfinite(around.hessian[row, column])
    return finite and count >= min_points


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _falls(here: Around, there: Around, min_points: int) -> bool:
    """Return whether the mean cost falls, over the points in view from both poses."""
    count = 0
    before = after = weight_before = weight_after = 0.0
    for point in range(len(here.seen)):
        if here.seen[point] and there.seen[point]:
            count += 1
            weight_before += here.weight[point]
            weight_after += there.weight[point]
            before += here.weight[point] * here.cost[point]
            after += there.weight[point] * there.cost[point]
    lower = after * weight_before < before * weight_after
    return lower and count >= min_points and _gradient(there, 0, np.empty(6))


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _solve_step(
    gradient: Doubles, hessian: Singles, damping: Doubles, floor: float, out: Doubles
) -> None:
    """Write the step of ``damping.solve_step``."""
    system = np.empty((6, 7))
    for row in range(6):
        own = hessian[row, row]
        added = max(own * damping[row], floor)
        out[row] = -gradient[row] / (abs(own) + added)  # of the diagonal alone
        for column in range(6):
            system[row, column] = hessian[row, column]
        system[row, row] += added
        system[row, 6] = -gradient[row]
    for k in range(6):  # Gauss and Jordan
        if not system[k, k] > 0:  # it is not positive definite
            return
        for row in range(6):
            share = system[row, k] / system[k, k]
            if row != k:
                for column in range(k, 7):
                    system[row, column] -= share * system[k, column]
    for k in range(6):
        out[k] = system[k, 6] / system[k, k]


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _move(pose: PoseArrays, step: Doubles, to: PoseArrays) -> tuple[float, float]:
    """Write the pose of ``damping.apply_step``; return the angle and the length of the step."""
    x, y, z = step[0], step[1], step[2]
    angle = sqrt(x * x + y * y + z * z)
    a, b = 1 - angle**2 / 6, 0.5 - angle**2 / 24
    if angle > 1e-4:  # below, the series are exact
        a, b = sin(angle) / angle, 2 * sin(angle / 2) ** 2 / angle**2
    by = np.empty((3, 3))
    by[0, 0], by[0, 1], by[0, 2] = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    by[1, 0], by[1, 1], by[1, 2] = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    by[2, 0], by[2, 1], by[2, 2] = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)
    for row in range(3):
        to.shift[row] = step[3 + row]
        for k in range(3):
            to.shift[row] += by[row, k] * pose.shift[k]
        for column in range(3):
            to.turn[row, column] = 0.0
            for k in range(3):
                to.turn[row, column] += by[row, k] * pose.turn[k, column]
    return angle, sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _project(cam_from_world: PoseArrays, points: Points, pose: int, out: View) -> None:
    """Write the projections of the used points for one pose."""
    turn = cam_from_world.turn.astype(np.float32)
    shift = cam_from_world.shift.astype(np.float32)
    positions, used, cameras = points.xyz[pose], points.used[pose], points.cameras
    k = pose if len(cameras.focal) > 1 else 0
    fx, fy = cameras.focal[k]
    principal, distortion, limit = cameras.principal[k], cameras.distortion[k], cameras.limit[k, 0]
    least_depth, most_slope = cameras.least_depth, cameras.most_slope
    bent = np.empty(5, np.float32)
    for point in range(len(used)):
        px, py, pz = positions[point]
        x = turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] * pz + shift[0]
        y = turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] * pz + shift[1]
        z = turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] * pz + shift[2]
        there = out.in_camera[point]
        there[0], there[1], there[2] = x, y, z
        out.valid[point] = False
        if not (used[point] and z > least_depth and max(abs(x), abs(y)) < most_slope * z):
            continue
        u, v = x / z, y / z
        if cameras.fisheye:
            inside = _bend_fisheye(u, v, distortion, limit, bent)
        else:
            inside = _bend(u, v, distortion, limit, bent)
        if not inside:
            continue
        out.valid[point] = True
        at, by = out.xy[point], out.jacobian[point]
        at[0], at[1] = fx * bent[0] + principal[0], fy * bent[1] + principal[1]
        by[0, 0], by[0, 1] = fx * bent[2] / z, fx * bent[3] / z
        by[1, 0], by[1, 1] = fy * bent[3] / z, fy * bent[4] / z
        by[0, 2] = -(by[0, 0] * u + by[0, 1] * v)
        by[1, 2] = -(by[1, 0] * u + by[1, 1] * v)


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _bend(u: np.float32, v: np.float32, by: Singles, limit: np.float32, out: Singles) -> bool:
    """Write a distorted ray with its derivatives xx, xy and yy; return whether it is valid."""
    k1, k2, p1, p2 = by[0], by[1], by[2], by[3]
    uu, vv, uv2 = u * u, v * v, 2 * u * v
    r2 = uu + vv
    radial = _ONE + r2 * (k1 + k2 * r2)
    slope = 2 * (k1 + 2 * k2 * r2)
    if len(by) > _POLYNOMIAL:
        radial, slope = _stretch(r2, by)
    out[0] = u * radial + p1 * uv2 + p2 * (r2 + 2 * uu)
    out[1] = v * radial + p2 * uv2 + p1 * (r2 + 2 * vv)
    out[2] = radial + slope * uu + 2 * p1 * v + 6 * p2 * u
    out[3] = slope * u * v + 2 * p1 * u + 2 * p2 * v
    out[4] = radial + slope * vv + 2 * p2 * u + 6 * p1 * v
    return bool(r2 < limit * limit and out[2] * out[4] - out[3] * out[3] > 0)


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _stretch(r2: np.float32, by: Singles) -> tuple[np.float32, np.float32]:
    """Return the rational factor at a squared radius, and twice its derivative."""
    k1, k2, k3, k4, k5, k6 = by[0], by[1], by[4], by[5], by[6], by[7]
    below = _ONE + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = (_ONE + r2 * (k1 + r2 * (k2 + r2 * k3))) / below
    above_slope = k1 + r2 * (2 * k2 + 3 * k3 * r2)
    below_slope = k4 + r2 * (2 * k5 + 3 * k6 * r2)
    return radial, 2 * (above_slope - radial * below_slope) / below


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _bend_fisheye(
    u: np.float32, v: np.float32, by: Singles, limit: np.float32, out: Singles
) -> bool:
    """Write the same as ``_bend`` for a fisheye."""
    k1, k2, k3, k4 = by
    r = max(np.sqrt(u * u + v * v), np.float32(1e-9))
    angle = np.arctan(r)
    t2 = angle * angle
    scale = angle * (_ONE + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) / r
    slope = _ONE + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
    along = (slope / (_ONE + r * r) - scale) / (r * r)
    out[0], out[1] = u * scale, v * scale
    out[2], out[3], out[4] = scale + along * u * u, along * u * v, scale + along * v * v
    return bool(angle < limit)


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _linearise(level: Level, pose: int, points: View, out: Around) -> None:
    """Write the cost around one pose."""
    maps, stride, border, twice_scale = level.maps, level.stride, level.border, level.twice_scale
    width, height = maps.width, maps.height
    seen, weight, cost, pull, hessian, cells = out
    last_x, last_y = np.float32(width - 1) - border, np.float32(height - 1) - border
    rows = np.empty((2, 6), np.float32)
    gram = np.empty(6, np.float32)
    for i in range(6):
        for j in range(6):
            hessian[i, j] = 0
    for point in range(len(points.valid)):
        seen[point], weight[point], cost[point] = False, 0, 0
        cells[point, 0] = cells[point, 1] = 1
        for i in range(6):
            pull[point, i] = 0
        if not points.valid[point]:
            continue
        x = points.xy[point, 0] / stride[0] - _HALF
        y = points.xy[point, 1] / stride[1] - _HALF
        if not (border <= x <= last_x and border <= y <= last_y):
            continue
        cells[point, 0], cells[point, 1] = x, y
        left = min(max(int(x), 1), width - 3)
        top = min(max(int(y), 1), height - 3)
        a, b = x - np.float32(left), y - np.float32(top)
        cell = maps.first[pose] + top * width + left
        sure = _ONE
        if level.has_trust:
            sure = _bilinear(maps.trust, cell, width, (a, b))
        if level.has_target_trust:
            sure *= level.target_trust[pose, point]
        if not sure > 0:
            continue
        _products(maps.features, cell, width, (a, b), level.target[pose, point], gram)
        for k in range(2):
            _row(points.in_camera[point], points.jacobian[point, k], stride[k], rows[k])
        share = sure / (_ONE + gram[0] / twice_scale)
        seen[point], weight[point] = True, sure
        cost[point] = twice_scale * np.log1p(gram[0] / twice_scale)
        gx, gy = share * gram[1], share * gram[2]
        gxx, gxy, gyy = share * gram[3], share * gram[4], share * gram[5]
        for i in range(6):
            along_x, along_y = rows[0, i], rows[1, i]
            pull[point, i] = gx * along_x + gy * along_y
            both_x, both_y = gxx * along_x + gxy * along_y, gxy * along_x + gyy * along_y
            for j in range(6):
                hessian[i, j] += both_x * rows[0, j] + both_y * rows[1, j]


@njit(inline="always", **CALLED)  # type: ignore[untyped-decorator]
def _bilinear(
    table: Singles, cell: int, width: int, between: tuple[np.float32, np.float32]
) -> np.float32:
    """Return the value between cells of a table of one channel."""
    (a, b), below = between, cell + width
    above = (_ONE - a) * table[cell, 0] + a * table[cell + 1, 0]
    value: np.float32 = (_ONE - b) * above
    value += b * ((_ONE - a) * table[below, 0] + a * table[below + 1, 0])
    return value


@njit(inline="always", **CALLED)  # type: ignore[untyped-decorator]
def _row(point: Singles, slope: Singles, stride: np.float32, row: Singles) -> None:
    """Write the derivative of a pixel's coordinate (cells) with respect to the pose."""
    (x, y, z), (of_x, of_y, of_z) = point, slope
    row[0], row[3] = (y * of_z - z * of_y) / stride, of_x / stride
    row[1], row[4] = (z * of_x - x * of_z) / stride, of_y / stride
    row[2], row[5] = (x * of_y - y * of_x) / stride, of_z / stride


@njit(inline="always", **CALLED)  # type: ignore[untyped-decorator]
def _products(
    features: Singles,
    cell: int,
    width: int,
    between: tuple[np.float32, np.float32],
    target: Singles,
    out: Singles,
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
    # A signed index would add a test for negative values and prevent vectorised loads.
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
