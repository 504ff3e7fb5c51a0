"""What ``residuals`` and ``descent`` compute, in compiled loops for processors.

Results differ by rounding alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import radians
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from baselines.align import kernels
from baselines.align.damping import FLOOR, LEAST_FACTOR, MOST_FACTOR
from baselines.align.options import Options
from baselines.align.sampling import CellTable
from scene.geometry.pose import Pose
from scene.geometry.projection import MAX_SLOPE, MIN_DEPTH, Intrinsics
from scene.runtime.loops import compiled

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
    f"Tuple((f8[::1], UniTuple(f8, 6), UniTuple(i8, 2))), {_AROUND})"
)


class LevelFields(NamedTuple):
    """What ``residuals.LevelCost`` knows of a level, in its names."""

    table: CellTable
    trust: CellTable | None
    first: Tensor
    stride: Tensor
    target: Tensor
    target_trust: Tensor | None
    border: float
    scale: float

    def arrays(self) -> kernels.Level:
        """Return the fields as the kernels take them."""
        # Confidence that is not known is one, and not read.
        one = torch.ones(1, 1)
        trust = one if self.trust is None else self.trust.cells.float()
        target_trust = one if self.target_trust is None else self.target_trust.float()
        features, sure, first = _arrays(self.table.cells, trust, self.first)
        target, target_sure, stride = _arrays(self.target, target_trust, self.stride)
        return (
            (features, sure, first, self.table.width, self.table.height),
            (target, target_sure),
            stride,
            (np.float32(self.border), np.float32(2 * self.scale**2)),
            (self.trust is not None, self.target_trust is not None),
        )


class Descent(NamedTuple):
    """The fields of ``descent.State``; ``around`` are those of ``Linearisation``."""

    pose: Pose
    around: tuple[Tensor, ...]
    iterations: Tensor
    damping: Tensor


# More than six parameters: they are those of ``descent.descend``, whose cost is in parts here.
def descended(
    level: LevelFields,
    points: tuple[Tensor, Tensor],
    camera: Intrinsics,
    pose: Pose,
    alive: Tensor,
    damping: Tensor,
    options: Options,
) -> Descent:
    """Return what ``descent.descend`` does, with careful steps.

    Args:
        level: what the cost is of.
        points: (M, N, 3), and which to use (M, N).
        camera: intrinsics, one or M.
        pose: (M) where to begin.
        alive: (M,) which to move.
        damping: (6,) factors of the Hessian's diagonal.
        options: how the level is minimised.
    """
    positions, used, moving = _arrays(*points, alive)
    turns, shifts = (np.array(each, float) for each in _arrays(pose.rotation, pose.translation))
    tried, factors = np.zeros(len(moving), np.int64), np.ones(len(moving))
    out = _empty(*used.shape)
    rules = (options.damping_change, LEAST_FACTOR, MOST_FACTOR, FLOOR)
    small = (radians(options.converged_deg), options.converged_m)
    compiled(kernels.descend, _DESCEND)(
        level.arrays(),
        (positions, used, _camera(camera)),
        (turns, shifts, moving, tried, factors),
        (*_arrays(damping.double()), (*rules, *small), (options.iterations, options.min_points)),
        out,
    )
    to = Pose(torch.from_numpy(turns), torch.from_numpy(shifts))
    around = tuple(map(torch.from_numpy, out))
    return Descent(to, around, torch.from_numpy(tried), torch.from_numpy(factors)[:, None])


def around(
    level: LevelFields, points: tuple[Tensor, Tensor], camera: Intrinsics, pose: Pose
) -> tuple[Tensor, ...]:
    """Return the fields of ``Linearisation`` of M poses, for points and a camera as above."""
    still = torch.zeros(len(level.first), dtype=torch.bool)
    return descended(level, points, camera, pose, still, torch.zeros(6), Options()).around


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
