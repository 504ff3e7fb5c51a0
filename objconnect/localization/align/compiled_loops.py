"""Compiled loops for the CPU that replace ``residuals`` and ``descent`` in torch.

Results differ by rounding alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from math import radians
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numba import boolean, f4, f8, i8, types
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.align import kernels, records
from objconnect.localization.align.damping import CHANGE, FLOOR, LEAST_FACTOR, MOST_FACTOR
from objconnect.localization.align.options import Options
from objconnect.localization.align.residuals import LevelCost, Linearisation
from objconnect.localization.align.state import State
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.projection import MAX_SLOPE, MIN_DEPTH, Intrinsics
from objconnect.scene.runtime.loops import compile_loop
from objconnect.scene.runtime.tuning import worker_threads


def _record(kind: type[NamedTuple], *fields: Any) -> Any:
    """Return Numba's type of a record from the types of its fields."""
    return types.NamedTuple(fields, kind)


_MAPS: Final = _record(records.Maps, f4[:, ::1], f4[:, ::1], i8[::1], i8, i8)
_LEVEL: Final = _record(
    records.Level, _MAPS, f4[:, :, ::1], f4[:, ::1], f4[::1], f4, f4, boolean, boolean
)
_CAMERAS: Final = _record(records.Cameras, *[f4[:, ::1]] * 4, f4, f4, boolean)
_POINTS: Final = _record(records.Points, f4[:, :, ::1], boolean[:, ::1], _CAMERAS)
_POSES: Final = _record(records.PoseArrays, f8[:, :, ::1], f8[:, ::1])
_AROUND: Final = _record(
    records.Around, boolean[:, ::1], f4[:, ::1], f4[:, ::1], *[f4[:, :, ::1]] * 3
)
_MOVING: Final = _record(records.Moving, _POSES, boolean[::1], i8[::1], f8[::1], _AROUND)
_RULES: Final = _record(records.Rules, f8[::1], *[f8] * 6, i8, i8)
_DESCEND: Final = types.void(_LEVEL, _POINTS, _MOVING, _RULES, i8, i8)
# Least number of points of all poses together for a second thread.
_WORTH_THREADS: Final = 1024


def descend_compiled(
    cost: LevelCost, pose: Pose, alive: Tensor, damping: Tensor, options: Options
) -> State:
    """Minimise the cost of one level as ``descent.descend`` does with careful steps."""
    positions, used, moved = _arrays(cost.points, cost.mask, alive)
    turns, shifts = (np.array(each, float) for each in _arrays(pose.rotation, pose.translation))
    (axes,) = _arrays(damping.double())
    level, points = _level(cost), records.Points(positions, used, _cameras(cost.intrinsics))
    moving = records.Moving(
        poses=records.PoseArrays(turns, shifts),
        alive=moved,
        tried=np.zeros(len(moved), np.int64),
        factors=np.ones(len(moved)),
        around=_empty(*used.shape),
    )
    rules = records.Rules(
        damping=axes,
        change=CHANGE,
        least=LEAST_FACTOR,
        most=MOST_FACTOR,
        floor=FLOOR,
        small_turn=radians(options.converged_deg),
        small_shift=options.converged_m,
        steps=options.iterations,
        min_points=options.min_points,
    )
    _in_parts(
        partial(compile_loop(kernels.descend, _DESCEND), level, points, moving, rules), *used.shape
    )
    to = Pose(*map(torch.from_numpy, moving.poses))
    there = Linearisation(*map(torch.from_numpy, moving.around))
    factors = torch.from_numpy(moving.factors)[:, None]
    return State(to, there, torch.from_numpy(moving.tried), factors)


def _in_parts(work: Callable[[int, int], None], poses: int, points: int) -> None:
    """Divide poses among as many threads as torch may use, this one included."""
    threads = min(torch.get_num_threads(), poses) if poses * points >= _WORTH_THREADS else 1
    own, *others = pairwise(poses * k // threads for k in range(threads + 1))
    if not others:
        work(*own)
        return
    with worker_threads() as pool:
        busy = [pool.submit(work, *part) for part in others]
        work(*own)
        for each in busy:
            each.result()


def around(cost: LevelCost, pose: Pose) -> Linearisation:
    """Compute the cost around poses as ``LevelCost.linearise`` does."""
    still = torch.zeros(len(cost.first), dtype=torch.bool)
    return descend_compiled(cost, pose, still, torch.zeros(6), Options()).around


def _level(cost: LevelCost) -> records.Level:
    # A missing confidence is a placeholder, which is not read.
    one = torch.ones(1, 1)
    trust = one if cost.trust is None else cost.trust.cells.float()
    target_trust = one if cost.target_trust is None else cost.target_trust.float()
    features, sure, first = _arrays(cost.table.cells, trust, cost.first)
    target, target_sure, stride = _arrays(cost.target, target_trust, cost.stride)
    return records.Level(
        maps=records.Maps(features, sure, first, cost.table.width, cost.table.height),
        target=target,
        target_trust=target_sure,
        stride=stride,
        border=np.float32(cost.border),
        twice_scale=np.float32(2 * cost.scale**2),
        has_trust=cost.trust is not None,
        has_target_trust=cost.target_trust is not None,
    )


def _empty(poses: int, points: int) -> records.Around:
    shape = (poses, points)
    return records.Around(
        np.empty(shape, np.bool_),
        np.empty(shape, np.float32),
        np.empty(shape, np.float32),
        np.empty((*shape, 6), np.float32),
        np.empty((poses, 6, 6), np.float32),
        np.empty((*shape, 2), np.float32),
    )


def _cameras(camera: Intrinsics) -> records.Cameras:
    fields = (camera.focal, camera.principal, camera.distortion, camera.limit[..., None])
    focal, principal, distortion, limit = _arrays(
        *(each.reshape(-1, each.shape[-1]) for each in fields)
    )
    least_depth, most_slope = np.float32(MIN_DEPTH), np.float32(MAX_SLOPE)
    return records.Cameras(
        focal, principal, distortion, limit, least_depth, most_slope, camera.fisheye
    )


def _arrays(*tensors: Tensor) -> Iterator[NDArray[Any]]:
    return (tensor.contiguous().numpy() for tensor in tensors)
