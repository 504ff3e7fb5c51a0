"""Compiled loops for the CPU that compute what ``residuals`` and ``descent`` compute in torch.

Their results differ from torch's only by rounding.
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
from objconnect.localization.align.damping import DAMPING_CHANGE, MAX_FACTOR, MIN_ADDED, MIN_FACTOR
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
_COST_ARRAYS: Final = _record(
    records.CostArrays, boolean[:, ::1], f4[:, ::1], f4[:, ::1], *[f4[:, :, ::1]] * 3
)
_POSE_BATCH: Final = _record(
    records.PoseBatch, _POSES, boolean[::1], i8[::1], f8[::1], _COST_ARRAYS
)
_DESCENT_OPTIONS: Final = _record(records.DescentOptions, f8[::1], *[f8] * 6, i8, i8)
_DESCEND: Final = types.void(_LEVEL, _POINTS, _POSE_BATCH, _DESCENT_OPTIONS, i8, i8)
# Least number of points of all poses together for which a second thread saves time.
_MIN_THREADED_POINTS: Final = 1024


def descend_compiled(
    cost: LevelCost, pose: Pose, active: Tensor, damping: Tensor, options: Options
) -> State:
    """Minimise the cost of one level as ``descent.descend`` does with adaptive damping.

    Arguments are those of ``descent.descend``.
    """
    positions, used, is_active = _arrays(cost.points, cost.mask, active)
    # Copies, because the loop changes the poses in place.
    rotations, translations = (
        np.array(each, float) for each in _arrays(pose.rotation, pose.translation)
    )
    (axes,) = _arrays(damping.double())
    level, points = _level(cost), records.Points(positions, used, _cameras(cost.intrinsics))
    batch = records.PoseBatch(
        poses=records.PoseArrays(rotations, translations),
        active=is_active,
        steps_tried=np.zeros(len(is_active), np.int64),
        damping_factors=np.ones(len(is_active)),
        linearisation=_empty(*used.shape),
    )
    descent_options = records.DescentOptions(
        damping=axes,
        damping_change=DAMPING_CHANGE,
        min_factor=MIN_FACTOR,
        max_factor=MAX_FACTOR,
        min_added=MIN_ADDED,
        converged_rad=radians(options.converged_deg),
        converged_m=options.converged_m,
        max_steps=options.iterations,
        min_points=options.min_points,
    )
    _run_in_parts(
        partial(compile_loop(kernels.descend, _DESCEND), level, points, batch, descent_options),
        *used.shape,
    )
    final_pose = Pose(*map(torch.from_numpy, batch.poses))
    linearisation = Linearisation(*map(torch.from_numpy, batch.linearisation))
    damping_factors = torch.from_numpy(batch.damping_factors)[:, None]
    return State(final_pose, linearisation, torch.from_numpy(batch.steps_tried), damping_factors)


def _run_in_parts(work: Callable[[int, int], None], poses: int, points: int) -> None:
    """Call ``work`` with ranges of poses in as many threads as torch may use, this one included."""
    threads = min(torch.get_num_threads(), poses) if poses * points >= _MIN_THREADED_POINTS else 1
    first_part, *others = pairwise(poses * k // threads for k in range(threads + 1))
    if not others:
        work(*first_part)
        return
    with worker_threads() as pool:
        futures = [pool.submit(work, *part) for part in others]
        work(*first_part)
        for future in futures:
            future.result()


def linearise_compiled(cost: LevelCost, pose: Pose) -> Linearisation:
    """Compute the cost around poses as ``LevelCost.linearise`` does."""
    none_active = torch.zeros(len(cost.first), dtype=torch.bool)
    return descend_compiled(cost, pose, none_active, torch.zeros(6), Options()).linearisation


def _level(cost: LevelCost) -> records.Level:
    # A confidence that is None becomes a placeholder, which the loop does not read.
    one = torch.ones(1, 1)
    confidence = one if cost.confidence is None else cost.confidence.values.float()
    reference_confidence = (
        one if cost.reference_confidence is None else cost.reference_confidence.float()
    )
    features, cell_confidence, first = _arrays(cost.table.values, confidence, cost.first)
    reference, point_confidence, stride = _arrays(cost.reference, reference_confidence, cost.stride)
    return records.Level(
        maps=records.Maps(features, cell_confidence, first, cost.table.width, cost.table.height),
        reference=reference,
        reference_confidence=point_confidence,
        stride=stride,
        border=np.float32(cost.border),
        twice_squared_scale=np.float32(2 * cost.scale**2),
        has_confidence=cost.confidence is not None,
        has_reference_confidence=cost.reference_confidence is not None,
    )


def _empty(poses: int, points: int) -> records.CostArrays:
    """Return uninitialised arrays for the linearisations of poses."""
    shape = (poses, points)
    return records.CostArrays(
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
    min_depth, max_slope = np.float32(MIN_DEPTH), np.float32(MAX_SLOPE)
    return records.Cameras(
        focal, principal, distortion, limit, min_depth, max_slope, camera.fisheye
    )


def _arrays(*tensors: Tensor) -> Iterator[NDArray[Any]]:
    return (tensor.contiguous().numpy() for tensor in tensors)
