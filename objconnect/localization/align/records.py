"""Records of arrays that compiled loops read and write, for M poses with N points each.

Numba's cache depends on the file ``kernels`` alone and on the order of fields: after a change of
the order here, touch that file.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]
Doubles = NDArray[np.float64]
Flags = NDArray[np.bool_]
Integers = NDArray[np.int64]


class Maps(NamedTuple):
    """Maps of queries as tables of cells.

    Attributes:
        features: (cells, C).
        trust: (cells, 1) confidence; a single cell if unknown.
        first: (M,) number of the first cell of each pose's map.
    """

    features: Singles
    trust: Singles
    first: Integers
    width: int
    height: int


class Level(NamedTuple):
    """One level of the cost; see ``residuals.LevelCost``.

    Attributes:
        target: (M, N, C) features of the points.
        target_trust: (M, N) confidence of the points; a single number if unknown.
        stride: (2,) pixels per cell, x and y.
        border: cells at the edge of a map in which points do not count.
        twice_scale: twice the squared scale of the robust cost.
        has_trust: whether the confidence of the queries is known.
        has_target_trust: whether the confidence of the points is known.
    """

    maps: Maps
    target: Singles
    target_trust: Singles
    stride: Singles
    border: np.float32
    twice_scale: np.float32
    has_trust: bool
    has_target_trust: bool


class Cameras(NamedTuple):
    """One camera for all poses, or M.

    Attributes:
        focal: (1 or M, 2) pixels.
        principal: (1 or M, 2) pixels.
        distortion: (1 or M, K).
        limit: (1 or M, 1) radius or angle beyond which the lens model folds.
        least_depth: least depth of a point, metres.
        most_slope: largest slope of a ray against the optical axis.
        fisheye: whether the model is a fisheye.
    """

    focal: Singles
    principal: Singles
    distortion: Singles
    limit: Singles
    least_depth: np.float32
    most_slope: np.float32
    fisheye: bool


class Points(NamedTuple):
    """Points and cameras.

    Attributes:
        xyz: (M, N, 3) metres.
        used: (M, N) whether a point is used.
    """

    xyz: Singles
    used: Flags
    cameras: Cameras


class PoseArrays(NamedTuple):
    """Poses ``cam_from_world``: ``turn`` (..., 3, 3) and ``shift`` (..., 3), metres."""

    turn: Doubles
    shift: Doubles


class Around(NamedTuple):
    """The fields of ``residuals.Linearisation``, of M poses or of one."""

    seen: Flags
    weight: Singles
    cost: Singles
    pull: Singles
    hessian: Singles
    cells: Singles


class Moving(NamedTuple):
    """Poses to minimise, and output arrays.

    Attributes:
        poses: (M,), changed in place.
        alive: (M,) whether a pose is minimised.
        tried: (M,) output: number of steps tried.
        factors: (M,) output: factors on the damping.
        around: output: the cost around the last poses.
    """

    poses: PoseArrays
    alive: Flags
    tried: Integers
    factors: Doubles
    around: Around


class Rules(NamedTuple):
    """Options of the minimisation of a level.

    Attributes:
        damping: (6,) factors of the diagonal of the Hessian.
        change: factor on the damping after a rejected step; an accepted one divides by it.
        least: least factor on the damping.
        most: largest factor on the damping.
        floor: least value that is added to the diagonal.
        small_turn: rotation of a step that ends a level, rad.
        small_shift: translation of a step that ends a level, metres.
    """

    damping: Doubles
    change: float
    least: float
    most: float
    floor: float
    small_turn: float
    small_shift: float
    steps: int
    min_points: int


class View(NamedTuple):
    """Projections of N points for one pose.

    Attributes:
        in_camera: (N, 3) metres in the frame of the camera.
        xy: (N, 2) pixels.
        valid: (N,) whether the projection is valid.
        jacobian: (N, 2, 3) derivatives of the pixels with respect to the points.
    """

    in_camera: Singles
    xy: Singles
    valid: Flags
    jacobian: Singles
