"""Loops over points that Numba compiles for ``objconnect.localization.align.compiled_loops``.

For each point, twelve cells of the feature map are read once, and only products of residuals and
slopes are written. All loops are in this file, because Numba's cache depends on the file.
"""

from __future__ import annotations

from math import isfinite, sin, sqrt

import numpy as np
from numba import njit

from objconnect.localization.align.records import (
    CostArrays,
    DescentOptions,
    Doubles,
    Level,
    Points,
    PoseArrays,
    PoseBatch,
    Singles,
    View,
)
from objconnect.scene.runtime.loops import INLINED_OPTIONS

_HALF, _ONE = np.float32(0.5), np.float32(1)
_POLYNOMIAL = 4  # coefficients of a lens without a denominator


def descend(
    level: Level, points: Points, batch: PoseBatch, options: DescentOptions, first: int, end: int
) -> None:
    """Minimise the cost of a range of poses.

    Args:
        level: features of queries and points.
        points: points and cameras.
        batch: the poses and the output arrays.
        options: options of the minimisation.
        first: index of the first pose.
        end: index after the last pose.
    """
    poses, out = batch.poses, batch.linearisation
    steps_tried, factors = batch.steps_tried, batch.damping_factors
    count = points.xyz.shape[1]
    view = View(
        np.empty((count, 3), np.float32),
        np.empty((count, 2), np.float32),
        np.empty(count, np.bool_),
        np.empty((count, 2, 3), np.float32),
    )
    there = CostArrays(
        np.empty(count, np.bool_),
        np.empty(count, np.float32),
        np.empty(count, np.float32),
        np.empty((count, 6), np.float32),
        np.empty((6, 6), np.float32),
        np.empty((count, 2), np.float32),
    )
    trial = PoseArrays(np.empty((3, 3)), np.empty(3))
    gradient, step = np.empty(6), np.empty(6)
    for k in range(first, end):
        pose = PoseArrays(poses.rotation[k], poses.translation[k])
        here = CostArrays(
            out.seen[k],
            out.weight[k],
            out.cost[k],
            out.point_gradient[k],
            out.hessian[k],
            out.cells[k],
        )
        step[:] = 0
        steps_tried[k], factors[k], ended = -1, 1.0, not batch.active[k]
        # The first round has a step of zero and computes the cost around the initial pose.
        while True:
            angle, length = _move(pose, step, trial)
            _project(trial, points, k, view)
            _linearise(level, k, view, there)
            steps_tried[k] += 1
            better = steps_tried[k] == 0 or _falls(here, there, options.min_points)
            if better:
                _accept(trial, there, pose, here)
            if steps_tried[k] > 0:
                ended = angle < options.converged_rad and length < options.converged_m
                change = options.damping_change
                factor = factors[k] / change if better else factors[k] * change
                factors[k] = min(max(factor, options.min_factor), options.max_factor)
            ended = ended or steps_tried[k] == options.max_steps
            if ended or not _gradient(here, options.min_points, gradient):
                break
            _solve_step(
                gradient, here.hessian, factors[k] * options.damping, options.min_added, step
            )


@njit(**INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _accept(found: PoseArrays, there: CostArrays, pose: PoseArrays, here: CostArrays) -> None:
    """Copy the pose ``found`` to ``pose``, and the cost around it, ``there``, to ``here``."""
    for row in range(3):
        pose.translation[row] = found.translation[row]
        for column in range(3):
            pose.rotation[row, column] = found.rotation[row, column]
    for row in range(6):
        for column in range(6):
            here.hessian[row, column] = there.hessian[row, column]
    for point in range(len(here.seen)):
        here.seen[point], here.weight[point] = there.seen[point], there.weight[point]
        here.cost[point] = there.cost[point]
        for k in range(6):
            here.point_gradient[point, k] = there.point_gradient[point, k]
        for k in range(2):
            here.cells[point, k] = there.cells[point, k]


@njit(**INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _gradient(linearisation: CostArrays, min_points: int, out: Doubles) -> bool:
    """Write the gradient (6,), and return whether a step can be computed."""
    finite, count = True, 0
    for k in range(6):
        out[k] = 0
    for point in range(len(linearisation.seen)):
        count += linearisation.seen[point]
        for k in range(6):
            out[k] += linearisation.point_gradient[point, k]
    for row in range(6):
        finite &= isfinite(out[row])
        for column in range(6):
            finite &= isfinite(linearisation.hessian[row, column])
    return finite and count >= min_points


@njit(**INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _falls(here: CostArrays, there: CostArrays, min_points: int) -> bool:
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


@njit(**INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _solve_step(
    gradient: Doubles, hessian: Singles, damping: Doubles, min_added: float, out: Doubles
) -> None:
    """Write the step of ``damping.solve_step``, by Gauss-Jordan elimination."""
    system = np.empty((6, 7))
    for row in range(6):
        diagonal = hessian[row, row]
        added = max(diagonal * damping[row], min_added)
        out[row] = -gradient[row] / (abs(diagonal) + added)  # the step of the diagonal alone
        for column in range(6):
            system[row, column] = hessian[row, column]
        system[row, row] += added
        system[row, 6] = -gradient[row]
    for k in range(6):
        if not system[k, k] > 0:  # not positive definite: the step of the diagonal stays
            return
        for row in range(6):
            share = system[row, k] / system[k, k]
            if row != k:
                for column in range(k, 7):
                    system[row, column] -= share * system[k, column]
    for k in range(6):
        out[k] = system[k, 6] / system[k, k]


@njit(**INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _move(pose: PoseArrays, step: Doubles, out: PoseArrays) -> tuple[float, float]:
    """Write the pose of ``damping.apply_step``; return the step's angle (rad) and length (m)."""
    x, y, z = step[0], step[1], step[2]
    angle = sqrt(x * x + y * y + z * z)
    a, b = 1 - angle**2 / 6, 0.5 - angle**2 / 24
    if angle > 1e-4:  # below, the series are exact
        a, b = sin(angle) / angle, 2 * sin(angle / 2) ** 2 / angle**2
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    R[1, 0], R[1, 1], R[1, 2] = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    R[2, 0], R[2, 1], R[2, 2] = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)
    for row in range(3):
        out.translation[row] = step[3 + row]
        for k in range(3):
            out.translation[row] += R[row, k] * pose.translation[k]
        for column in range(3):
            out.rotation[row, column] = 0.0
            for k in range(3):
                out.rotation[row, column] += R[row, k] * pose.rotation[k, column]
    return angle, sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)


@njit(**INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _project(cam_from_world: PoseArrays, points: Points, pose: int, out: View) -> None:
    """Write the projections of the used points for one pose."""
    rotation = cam_from_world.rotation.astype(np.float32)
    translation = cam_from_world.translation.astype(np.float32)
    positions, used, cameras = points.xyz[pose], points.used[pose], points.cameras
    k = pose if len(cameras.focal) > 1 else 0
    fx, fy = cameras.focal[k]
    principal, distortion, limit = cameras.principal[k], cameras.distortion[k], cameras.limit[k, 0]
    min_depth, max_slope = cameras.min_depth, cameras.max_slope
    distorted = np.empty(5, np.float32)
    for point in range(len(used)):
        px, py, pz = positions[point]
        x = rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz + translation[0]
        y = rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz + translation[1]
        z = rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz + translation[2]
        in_camera = out.in_camera[point]
        in_camera[0], in_camera[1], in_camera[2] = x, y, z
        out.valid[point] = False
        if not (used[point] and z > min_depth and max(abs(x), abs(y)) < max_slope * z):
            continue
        u, v = x / z, y / z
        if cameras.fisheye:
            inside = _distort_fisheye(u, v, distortion, limit, distorted)
        else:
            inside = _distort(u, v, distortion, limit, distorted)
        if not inside:
            continue
        out.valid[point] = True
        xy, jacobian = out.xy[point], out.jacobian[point]
        xy[0], xy[1] = fx * distorted[0] + principal[0], fy * distorted[1] + principal[1]
        jacobian[0, 0], jacobian[0, 1] = fx * distorted[2] / z, fx * distorted[3] / z
        jacobian[1, 0], jacobian[1, 1] = fy * distorted[3] / z, fy * distorted[4] / z
        jacobian[0, 2] = -(jacobian[0, 0] * u + jacobian[0, 1] * v)
        jacobian[1, 2] = -(jacobian[1, 0] * u + jacobian[1, 1] * v)


@njit(**INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _distort(u: np.float32, v: np.float32, lens: Singles, limit: np.float32, out: Singles) -> bool:
    """Write a distorted ray (x, y) and its derivatives dx/du, dx/dv = dy/du and dy/dv, for the
    coefficients ``lens`` of a lens model; return whether the ray is within the model's limit."""
    k1, k2, p1, p2 = lens[0], lens[1], lens[2], lens[3]
    uu, vv, uv2 = u * u, v * v, 2 * u * v
    r2 = uu + vv
    radial = _ONE + r2 * (k1 + k2 * r2)
    slope = 2 * (k1 + 2 * k2 * r2)
    if len(lens) > _POLYNOMIAL:
        radial, slope = _rational_radial(r2, lens)
    out[0] = u * radial + p1 * uv2 + p2 * (r2 + 2 * uu)
    out[1] = v * radial + p2 * uv2 + p1 * (r2 + 2 * vv)
    out[2] = radial + slope * uu + 2 * p1 * v + 6 * p2 * u
    out[3] = slope * u * v + 2 * p1 * u + 2 * p2 * v
    out[4] = radial + slope * vv + 2 * p2 * u + 6 * p1 * v
    return bool(r2 < limit * limit and out[2] * out[4] - out[3] * out[3] > 0)


@njit(**INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _rational_radial(r2: np.float32, lens: Singles) -> tuple[np.float32, np.float32]:
    """Return the rational radial factor at a squared radius, and twice its derivative."""
    k1, k2, k3, k4, k5, k6 = lens[0], lens[1], lens[4], lens[5], lens[6], lens[7]
    below = _ONE + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = (_ONE + r2 * (k1 + r2 * (k2 + r2 * k3))) / below
    above_slope = k1 + r2 * (2 * k2 + 3 * k3 * r2)
    below_slope = k4 + r2 * (2 * k5 + 3 * k6 * r2)
    return radial, 2 * (above_slope - radial * below_slope) / below


@njit(**INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _distort_fisheye(
    u: np.float32, v: np.float32, lens: Singles, limit: np.float32, out: Singles
) -> bool:
    """Write the results of ``_distort`` for a fisheye, whose limit is an angle (rad)."""
    k1, k2, k3, k4 = lens
    r = max(np.sqrt(u * u + v * v), np.float32(1e-9))
    angle = np.arctan(r)
    t2 = angle * angle
    scale = angle * (_ONE + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) / r
    slope = _ONE + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
    along = (slope / (_ONE + r * r) - scale) / (r * r)
    out[0], out[1] = u * scale, v * scale
    out[2], out[3], out[4] = scale + along * u * u, along * u * v, scale + along * v * v
    return bool(angle < limit)


@njit(**INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _linearise(level: Level, pose: int, points: View, out: CostArrays) -> None:
    """Write the cost around one pose, given the projections of its points."""
    maps, stride, border = level.maps, level.stride, level.border
    twice_squared_scale = level.twice_squared_scale
    width, height = maps.width, maps.height
    seen, weight, cost, point_gradient, hessian, cells = out
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
            point_gradient[point, i] = 0
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
        confidence = _ONE
        if level.has_confidence:
            confidence = _bilinear(maps.confidence, cell, width, (a, b))
        if level.has_reference_confidence:
            confidence *= level.reference_confidence[pose, point]
        if not confidence > 0:
            continue
        _products(maps.features, cell, width, (a, b), level.reference[pose, point], gram)
        for k in range(2):
            _row(points.in_camera[point], points.jacobian[point, k], stride[k], rows[k])
        robust = confidence / (_ONE + gram[0] / twice_squared_scale)
        seen[point], weight[point] = True, confidence
        cost[point] = twice_squared_scale * np.log1p(gram[0] / twice_squared_scale)
        gx, gy = robust * gram[1], robust * gram[2]
        gxx, gxy, gyy = robust * gram[3], robust * gram[4], robust * gram[5]
        for i in range(6):
            along_x, along_y = rows[0, i], rows[1, i]
            point_gradient[point, i] = gx * along_x + gy * along_y
            both_x, both_y = gxx * along_x + gxy * along_y, gxy * along_x + gyy * along_y
            for j in range(6):
                hessian[i, j] += both_x * rows[0, j] + both_y * rows[1, j]


@njit(inline="always", **INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _bilinear(
    table: Singles, cell: int, width: int, between: tuple[np.float32, np.float32]
) -> np.float32:
    """Interpolate a table of one channel at the position ``between`` (cells) after ``cell``."""
    (a, b), below = between, cell + width
    above = (_ONE - a) * table[cell, 0] + a * table[cell + 1, 0]
    value: np.float32 = (_ONE - b) * above
    value += b * ((_ONE - a) * table[below, 0] + a * table[below + 1, 0])
    return value


@njit(inline="always", **INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _row(point: Singles, slope: Singles, stride: np.float32, row: Singles) -> None:
    """Write the derivative (6,) of a coordinate (cells) by the pose; ``slope`` is by the point."""
    (x, y, z), (dx, dy, dz) = point, slope
    row[0], row[3] = (y * dz - z * dy) / stride, dx / stride
    row[1], row[4] = (z * dx - x * dz) / stride, dy / stride
    row[2], row[5] = (x * dy - y * dx) / stride, dz / stride


@njit(inline="always", **INLINED_OPTIONS)  # type: ignore[untyped-decorator]
def _products(
    features: Singles,
    cell: int,
    width: int,
    between: tuple[np.float32, np.float32],
    reference: Singles,
    out: Singles,
) -> None:
    """Sum the products of residual and slopes over the channels: rr, rx, ry, xx, xy, yy.

    The value is interpolated at the position ``between`` (cells) after ``cell``; slopes are its
    central differences.
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
    for c in range(np.uint64(len(reference))):
        # Values interpolated along columns and rows; slopes are their differences.
        left = b1 * top_left[c] + b * low_left[c]
        right = b1 * top_right[c] + b * low_right[c]
        before = b1 * before_top[c] + b * before_low[c]
        after = b1 * after_top[c] + b * after_low[c]
        top = a1 * top_left[c] + a * top_right[c]
        low = a1 * low_left[c] + a * low_right[c]
        over = a1 * over_left[c] + a * over_right[c]
        under = a1 * under_left[c] + a * under_right[c]
        residual = b1 * top + b * low - reference[c]
        slope_x = _HALF * (a1 * (right - before) + a * (after - left))
        slope_y = _HALF * (b1 * (low - over) + b * (under - top))
        rr += residual * residual
        rx += residual * slope_x
        ry += residual * slope_y
        xx += slope_x * slope_x
        xy += slope_x * slope_y
        yy += slope_y * slope_y
    out[0], out[1], out[2], out[3], out[4], out[5] = rr, rx, ry, xx, xy, yy
