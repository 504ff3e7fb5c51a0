"""Loops over points that Numba compiles for ``objconnect.localization.align.compiled``.

A point is finished before the next begins: its twelve cells are read once, and only its products
are written. It is over 400 lines because all loops are in this file, by which Numba knows what it
kept of them.
"""

from __future__ import annotations

from math import isfinite, sin, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from objconnect.scene.runtime.loops import CALLED

Singles = NDArray[np.float32]
Doubles = NDArray[np.float64]
Flags = NDArray[np.bool_]
Integers = NDArray[np.int64]
Maps = tuple[Singles, Singles, Integers, int, int]
"""Tables of features and of confidence, the first cell of each pose's maps, width and height."""
Targets = tuple[Singles, Singles]
"""Features and confidence of the points."""
Numbers = tuple[np.float32, np.float32]
Level = tuple[Maps, Targets, Singles, Numbers, tuple[bool, bool]]
"""Then pixels per cell; border, and twice the squared scale of the robust cost; whether there is
confidence of the query, and of the points."""
Camera = tuple[tuple[Singles, Singles, Singles, Singles], Numbers, bool]
"""Focal lengths, principal points, distortion and limit of one or M; least depth, steepest ray;
whether it is a fisheye."""
View = tuple[Singles, Singles, Flags, Singles]
"""Points in the frames of cameras, their pixels, whether these are valid, and derivatives."""
Around = tuple[Flags, Singles, Singles, Singles, Singles, Singles]
"""The fields of ``residuals.Linearisation``."""

_HALF, _ONE = np.float32(0.5), np.float32(1)
# Coefficients of a lens without a denominator.
_POLYNOMIAL = 4


def descend(
    level: Level,
    points: tuple[Singles, Flags, Camera],
    state: tuple[Doubles, Doubles, Flags, Integers, Doubles],
    options: tuple[Doubles, tuple[float, float, float, float, float, float], tuple[int, ...]],
    out: Around,
) -> None:
    """Move each pose to where its cost is least.

    Args:
        level: what the cost is of.
        points: (M, N, 3), which of them to use, and the cameras.
        state: rotations, translations (changed); which to move; steps tried, damping (written).
        options: damping (6,); what a rejected step multiplies it by, the least and the most of that
            factor, the least that is added to the diagonal, the turn (rad) and the shift (m) that
            end a level; the most steps, the fewest points, the first pose and the end of them.
        out: the cost around the last poses.
    """
    positions, used, camera = points
    turns, shifts, alive, tried, factors = state
    damping, (change, least, most, floor, small_turn, small_shift), whole = options
    steps, min_points, first, end = whole
    seen, weight, cost, pull, hessian, cells = out
    number = positions.shape[1]
    view = (
        np.empty((number, 3), np.float32),
        np.empty((number, 2), np.float32),
        np.empty(number, np.bool_),
        np.empty((number, 2, 3), np.float32),
    )
    there = (
        np.empty(number, np.bool_),
        np.empty(number, np.float32),
        np.empty(number, np.float32),
        np.empty((number, 6), np.float32),
        np.empty((6, 6), np.float32),
        np.empty((number, 2), np.float32),
    )
    gradient, step = np.empty(6), np.empty(6)
    turn, shift = np.empty((3, 3)), np.empty(3)
    for pose in range(first, end):
        own = (positions[pose], used[pose])
        here = (seen[pose], weight[pose], cost[pose], pull[pose], hessian[pose], cells[pose])
        step[:] = 0
        tried[pose], factors[pose], ended = -1, 1.0, not alive[pose]
        while True:
            angle, length = _move(turns[pose], shifts[pose], step, turn, shift)
            _project((turn, shift), own, (camera, pose), view)
            _linearise(level, pose, view, there)
            tried[pose] += 1
            better = tried[pose] == 0 or _falls(here, there, min_points)
            if better:
                _accept((turn, shift), there, (turns[pose], shifts[pose]), here)
            if tried[pose] > 0:
                ended = angle < small_turn and length < small_shift
                factor = factors[pose] / change if better else factors[pose] * change
                factors[pose] = min(max(factor, least), most)
            if ended or tried[pose] == steps or not _gradient(here, min_points, gradient):
                break
            _damped_step(gradient, here[4], factors[pose] * damping, floor, step)


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _accept(
    found: tuple[Doubles, Doubles], there: Around, pose: tuple[Doubles, Doubles], here: Around
) -> None:
    """Copy a pose and the cost around it."""
    for row in range(3):
        pose[1][row] = found[1][row]
        for column in range(3):
            pose[0][row, column] = found[0][row, column]
    for row in range(6):
        for column in range(6):
            here[4][row, column] = there[4][row, column]
    for point in range(len(here[0])):
        here[0][point], here[1][point] = there[0][point], there[1][point]
        here[2][point] = there[2][point]
        for k in range(6):
            here[3][point, k] = there[3][point, k]
        for k in range(2):
            here[5][point, k] = there[5][point, k]


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _gradient(around: Around, min_points: int, out: Doubles) -> bool:
    """Write the gradient (6,), and return whether a step can be computed."""
    seen, _, _, pull, hessian, _ = around
    finite, count = True, 0
    for k in range(6):
        out[k] = 0
    for point in range(len(seen)):
        count += seen[point]
        for k in range(6):
            out[k] += pull[point, k]
    for row in range(6):
        finite &= isfinite(out[row])
        for column in range(6):
            finite &= isfinite(hessian[row, column])
    return finite and count >= min_points


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _falls(here: Around, there: Around, min_points: int) -> bool:
    """Return whether the mean cost falls, over the points in view from both poses."""
    count = 0
    before = after = weight_before = weight_after = 0.0
    for point in range(len(here[0])):
        if here[0][point] and there[0][point]:
            count += 1
            weight_before += here[1][point]
            weight_after += there[1][point]
            before += here[1][point] * here[2][point]
            after += there[1][point] * there[2][point]
    lower = after * weight_before < before * weight_after
    return lower and count >= min_points and _gradient(there, 0, np.empty(6))


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _damped_step(
    gradient: Doubles, hessian: Singles, damping: Doubles, floor: float, out: Doubles
) -> None:
    """Write the step of ``damping.damped_step``."""
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
def _move(
    turn: Doubles, shift: Doubles, step: Doubles, to_turn: Doubles, to_shift: Doubles
) -> tuple[float, float]:
    """Write the pose of ``damping.moved``, and return the angle and the length of the step."""
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
        to_shift[row] = step[3 + row]
        for k in range(3):
            to_shift[row] += by[row, k] * shift[k]
        for column in range(3):
            to_turn[row, column] = 0.0
            for k in range(3):
                to_turn[row, column] += by[row, k] * turn[k, column]
    return angle, sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _project(
    cam_from_world: tuple[Doubles, Doubles],
    points: tuple[Singles, Flags],
    camera: tuple[Camera, int],
    out: View,
) -> None:
    """Write what one pose sees of the points to use."""
    turn, shift = cam_from_world[0].astype(np.float32), cam_from_world[1].astype(np.float32)
    positions, used = points
    ((focal, principal, distortion, limit), (least_depth, most_slope), fisheye), pose = camera
    in_camera, xy, valid, jacobian = out
    k = pose if len(focal) > 1 else 0
    fx, fy = focal[k]
    bent = np.empty(5, np.float32)
    for point in range(len(used)):
        px, py, pz = positions[point]
        x = turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] * pz + shift[0]
        y = turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] * pz + shift[1]
        z = turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] * pz + shift[2]
        there = in_camera[point]
        there[0], there[1], there[2] = x, y, z
        valid[point] = False
        if not (used[point] and z > least_depth and max(abs(x), abs(y)) < most_slope * z):
            continue
        u, v = x / z, y / z
        if fisheye:
            inside = _bend_fisheye(u, v, distortion[k], limit[k, 0], bent)
        else:
            inside = _bend(u, v, distortion[k], limit[k, 0], bent)
        if not inside:
            continue
        valid[point] = True
        at, by = xy[point], jacobian[point]
        at[0], at[1] = fx * bent[0] + principal[k, 0], fy * bent[1] + principal[k, 1]
        by[0, 0], by[0, 1] = fx * bent[2] / z, fx * bent[3] / z
        by[1, 0], by[1, 1] = fy * bent[3] / z, fy * bent[4] / z
        by[0, 2] = -(by[0, 0] * u + by[0, 1] * v)
        by[1, 2] = -(by[1, 0] * u + by[1, 1] * v)


@njit(**CALLED)  # type: ignore[untyped-decorator]
def _bend(u: np.float32, v: np.float32, by: Singles, limit: np.float32, out: Singles) -> bool:
    """Write what distortion makes of a ray, with derivatives xx, xy and yy, if it is inside."""
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
    """Write the same of a fisheye."""
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
    (features, trust, first, width, height), targets, stride, numbers, trusted = level
    target, target_trust = targets
    in_camera, xy, valid, jacobian = points
    border, twice_scale = numbers
    seen, weight, cost, pull, hessian, cells = out
    last_x, last_y = np.float32(width - 1) - border, np.float32(height - 1) - border
    rows = np.empty((2, 6), np.float32)
    gram = np.empty(6, np.float32)
    for i in range(6):
        for j in range(6):
            hessian[i, j] = 0
    for point in range(len(valid)):
        seen[point], weight[point], cost[point] = False, 0, 0
        cells[point, 0] = cells[point, 1] = 1
        for i in range(6):
            pull[point, i] = 0
        if not valid[point]:
            continue
        x = xy[point, 0] / stride[0] - _HALF
        y = xy[point, 1] / stride[1] - _HALF
        if not (border <= x <= last_x and border <= y <= last_y):
            continue
        cells[point, 0], cells[point, 1] = x, y
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
            _row(in_camera[point], jacobian[point, k], stride[k], rows[k])
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
    """Write the derivative of a pixel's coordinate, in cells, by the tangent of the pose."""
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
