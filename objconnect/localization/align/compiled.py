"""What ``residuals`` and ``descent`` compute, in compiled loops for processors.

Results differ by rounding alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from math import radians
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.align import kernels
from objconnect.localization.align.damping import CHANGE, FLOOR, LEAST_FACTOR, MOST_FACTOR
from objconnect.localization.align.options import Options
from objconnect.localization.align.residuals import LevelCost, Linearisation
from objconnect.localization.align.state import State
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.projection import MAX_SLOPE, MIN_DEPTH, Intrinsics
from objconnect.scene.runtime.loops import compiled
from objconnect.scene.runtime.threads import thread_pool

# Types of the arguments of ``kernels.descend``.
_CAMERA: Final = "Tuple((UniTuple(f4[:,::1], 4), UniTuple(f4, 2), b1))"
_LEVEL: Final = (
    "Tuple((Tuple((f4[:,::1], f4[:,::1], i8[::1], i8, i8)), Tuple((f4[:,:,::1], f4[:,::1])), "
    "f4[::1], UniTuple(f4, 2), UniTuple(b1, 2)))"
)
_AROUND: Final = "Tuple((b1[:,::1], f4[:,::1], f4[:,::1], f4[:,:,::1], f4[:,:,::1], f4[:,:,::1]))"
_DESCEND: Final = (
    f"void({_LEVEL}, Tuple((f4[:,:,::1], b1[:,::1], {_CAMERA})), "
    "Tuple((f8[:,:,::1], f8[:,::1], b1[::1], i8[::1], f8[::1])), "
    f"Tuple((f8[::1], UniTuple(f8, 6), UniTuple(i8, 4))), {_AROUND})"
)
# Poses of fewer points than this in all are not worth a second thread.
_WORTH_THREADS: Final = 1024


def descended(
    cost: LevelCost, pose: Pose, alive: Tensor, damping: Tensor, options: Options
) -> State:
    """Return what ``descent.descend`` does, with careful steps."""
    positions, used, moving = _arrays(cost.points, cost.mask, alive)
    turns, shifts = (np.array(each, float) for each in _arrays(pose.rotation, pose.translation))
    tried, factors = np.zeros(len(moving), np.int64), np.ones(len(moving))
    out = _empty(*used.shape)
    rules = (CHANGE, LEAST_FACTOR, MOST_FACTOR, FLOOR)
    small = (radians(options.converged_deg), options.converged_m)
    loops, level = compiled(kernels.descend, _DESCEND), _level(cost)
    points, state = (
        (positions, used, _camera(cost.intrinsics)),
        (turns, shifts, moving, tried, factors),
    )
    (axes,), limits = _arrays(damping.double()), (options.iterations, options.min_points)

    def descend(first: int, end: int) -> None:
        loops(level, points, state, (axes, (*rules, *small), (*limits, first, end)), out)

    _in_parts(descend, *used.shape)
    to = Pose(torch.from_numpy(turns), torch.from_numpy(shifts))
    there = Linearisation(*map(torch.from_numpy, out))
    return State(to, there, torch.from_numpy(tried), torch.from_numpy(factors)[:, None])


def _in_parts(work: Callable[[int, int], None], poses: int, points: int) -> None:
    """Do work on the first poses here, and on others in as many threads as torch may use."""
    threads = min(torch.get_num_threads(), poses) if poses * points >= _WORTH_THREADS else 1
    own, *others = pairwise(poses * k // threads for k in range(threads + 1))
    busy = [thread_pool().submit(work, *part) for part in others]
    work(*own)
    for each in busy:
        each.result()


def around(cost: LevelCost, pose: Pose) -> Linearisation:
    """Return what ``LevelCost.linearise`` does."""
    still = torch.zeros(len(cost.first), dtype=torch.bool)
    return descended(cost, pose, still, torch.zeros(6), Options()).around


def _level(cost: LevelCost) -> kernels.Level:
    # Confidence that is not known is one, and not read.
    one = torch.ones(1, 1)
    trust = one if cost.trust is None else cost.trust.cells.float()
    target_trust = one if cost.target_trust is None else cost.target_trust.float()
    features, sure, first = _arrays(cost.table.cells, trust, cost.first)
    target, target_sure, stride = _arrays(cost.target, target_trust, cost.stride)
    return (
        (features, sure, first, cost.table.width, cost.table.height),
        (target, target_sure),
        stride,
        (np.float32(cost.border), np.float32(2 * cost.scale**2)),
        (cost.trust is not None, cost.target_trust is not None),
    )


def _empty(poses: int, points: int) -> kernels.Around:
    shape = (poses, points)
    return (
        np.empty(shape, np.bool_),
        np.empty(shape, np.float32),
        np.empty(shape, np.float32),
        np.empty((*shape, 6), np.float32),
        np.empty((poses, 6, 6), np.float32),
        np.empty((*shape, 2), np.float32),
    )


def _camera(camera: Intrinsics) -> kernels.Camera:
    fields = (camera.focal, camera.principal, camera.distortion, camera.limit[..., None])
    focal, principal, distortion, limit = _arrays(
        *(each.reshape(-1, each.shape[-1]) for each in fields)
    )
    bounds = (np.float32(MIN_DEPTH), np.float32(MAX_SLOPE))
    return (focal, principal, distortion, limit), bounds, camera.fisheye


def _arrays(*tensors: Tensor) -> Iterator[NDArray[Any]]:
    return (tensor.contiguous().numpy() for tensor in tensors)
