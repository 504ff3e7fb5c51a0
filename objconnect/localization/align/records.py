"""Named tuples of arrays that compiled loops read and write, for M poses with N points each.

Numba's cache is renewed only if ``kernels.py`` changes. After a change of the order of fields here,
touch that file.

A cached loop that refers to a class that no longer exists cannot be loaded. The name of the cache
file contains the line number of ``kernels.descend``. After renaming a class here, move that
function to another line, so that Numba writes a new file.
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
    """Feature maps of queries as tables of cells.

    Attributes:
        features: (cells, C).
        confidence: (cells, 1); a single cell if unknown.
        first: (M,) index of the first cell of each pose's map.
        width: cells in a row of a map.
        height: rows of a map.
    """

    features: Singles
    confidence: Singles
    first: Integers
    width: int
    height: int


class Level(NamedTuple):
    """One level of the cost; see ``residuals.LevelCost``.

    Attributes:
        reference: (M, N, C) features of the points.
        reference_confidence: (M, N) confidence of the points; a single number if unknown.
        stride: (2,) pixels per cell, x and y.
        border: cells at the edge of a map in which points are ignored.
        twice_squared_scale: twice the squared scale of the robust cost.
        has_confidence: whether the confidence of the queries is known.
        has_reference_confidence: whether the confidence of the points is known.
    """

    maps: Maps
    reference: Singles
    reference_confidence: Singles
    stride: Singles
    border: np.float32
    twice_squared_scale: np.float32
    has_confidence: bool
    has_reference_confidence: bool


class Cameras(NamedTuple):
    """One camera for all poses, or M.

    Attributes:
        focal: (1 or M, 2) pixels.
        principal: (1 or M, 2) pixels.
        distortion: (1 or M, K).
        limit: (1 or M, 1) normalised radius, or angle (rad) of a fisheye, beyond which the lens
            model folds over.
        min_depth: least depth of a point, metres.
        max_slope: largest tangent of the angle between a ray and the optical axis.
        fisheye: whether the model is a fisheye.
    """

    focal: Singles
    principal: Singles
    distortion: Singles
    limit: Singles
    min_depth: np.float32
    max_slope: np.float32
    fisheye: bool


class Points(NamedTuple):
    """Points and cameras.

    Attributes:
        xyz: (M, N, 3) metres in the frame of the poses.
        used: (M, N) whether a point is used.
        cameras: cameras of the queries.
    """

    xyz: Singles
    used: Flags
    cameras: Cameras


class PoseArrays(NamedTuple):
    """Poses ``cam_from_world``: ``rotation`` (..., 3, 3), ``translation`` (..., 3) in metres."""

    rotation: Doubles
    translation: Doubles


class CostArrays(NamedTuple):
    """The fields of ``residuals.Linearisation``, of M poses or of one."""

    seen: Flags
    weight: Singles
    cost: Singles
    point_gradient: Singles
    hessian: Singles
    cells: Singles


class PoseBatch(NamedTuple):
    """Poses to refine, and output arrays.

    Attributes:
        poses: (M,), changed in place.
        active: (M,) whether the cost of a pose is minimised.
        steps_tried: (M,) output: number of steps tried.
        damping_factors: (M,) output: factors on the damping.
        linearisation: output: the cost around the final poses.
    """

    poses: PoseArrays
    active: Flags
    steps_tried: Integers
    damping_factors: Doubles
    linearisation: CostArrays


class DescentOptions(NamedTuple):
    """Options of the minimisation of a level.

    Attributes:
        damping: (6,) factors on the diagonal of the Hessian.
        damping_change: factor on the damping after a rejected step; an accepted step divides by it.
        min_factor: least factor on the damping.
        max_factor: largest factor on the damping.
        min_added: least value that is added to the diagonal.
        converged_rad: radians; a level ends at a step that rotates by less than this and
            translates by less than ``converged_m``.
        converged_m: metres; see ``converged_rad``.
        max_steps: maximum number of steps.
        min_points: minimum number of points in view.
    """

    damping: Doubles
    damping_change: float
    min_factor: float
    max_factor: float
    min_added: float
    converged_rad: float
    converged_m: float
    max_steps: int
    min_points: int


class View(NamedTuple):
    """Projections of N points at one pose.

    Attributes:
        in_camera: (N, 3) metres in the frame of the camera.
        xy: (N, 2) pixels.
        valid: (N,) whether the projection is valid.
        jacobian: (N, 2, 3) derivatives of ``xy`` with respect to ``in_camera``.
    """

    in_camera: Singles
    xy: Singles
    valid: Flags
    jacobian: Singles
