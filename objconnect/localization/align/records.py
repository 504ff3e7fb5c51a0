"""What compiled loops take and write, by name: arrays of M poses that see N points each.

Numba keeps what it compiled until ``kernels`` changes, and knows fields by their place: after a
change of their order here, write that file anew.
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
        trust: (cells, 1) confidence; one cell where it is not known.
        first: (M,) the first cell of each pose's map.
        width: cells.
        height: cells.
    """

    features: Singles
    trust: Singles
    first: Integers
    width: int
    height: int


class Level(NamedTuple):
    """One level of the cost; ``residuals.LevelCost`` describes it.

    Attributes:
        maps: of the queries.
        target: (M, N, C) features of the points.
        target_trust: (M, N) confidence of the points; one number where it is not known.
        stride: (2,) pixels per cell, x and y.
        border: cells at the edge of a map in which points do not count.
        twice_scale: twice the squared scale of the robust cost.
        has_trust: whether there is confidence of the queries.
        has_target_trust: whether there is confidence of the points.
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
        limit: (1 or M, 1) radius or angle beyond which the lens folds.
        least_depth: metres in front of the camera.
        most_slope: of a ray against the axis.
        fisheye: whether they are fisheyes.
    """

    focal: Singles
    principal: Singles
    distortion: Singles
    limit: Singles
    least_depth: np.float32
    most_slope: np.float32
    fisheye: bool


class Points(NamedTuple):
    """Points, and the cameras that see them.

    Attributes:
        xyz: (M, N, 3) metres.
        used: (M, N) which of them to use.
        cameras: of the poses.
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
    """Poses that are moved, and what is written of them.

    Attributes:
        poses: (M,), changed.
        alive: (M,) which of them to move.
        tried: (M,) steps tried, written.
        factors: (M,) on the damping, written.
        around: the cost around the last poses, written.
    """

    poses: PoseArrays
    alive: Flags
    tried: Integers
    factors: Doubles
    around: Around


class Rules(NamedTuple):
    """How the cost of a level is minimised.

    Attributes:
        damping: (6,) factors of the diagonal of the Hessian.
        change: what a rejected step multiplies the damping by, and a taken one divides it by.
        least: least factor on the damping.
        most: most of it.
        floor: least that is added to the diagonal.
        small_turn: rad that end a level, with
        small_shift: metres.
        steps: most steps.
        min_points: fewest points in view.
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
    """What one pose sees of N points.

    Attributes:
        in_camera: (N, 3) metres in the frame of the camera.
        xy: (N, 2) pixels.
        valid: (N,) whether these are in the picture's reach.
        jacobian: (N, 2, 3) derivatives of the pixels by the points.
    """

    in_camera: Singles
    xy: Singles
    valid: Flags
    jacobian: Singles
