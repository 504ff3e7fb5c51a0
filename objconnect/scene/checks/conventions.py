"""Common alternative conventions of poses, pixels and depths.

Each ``Convention`` converts data of another convention into ours. If a scene is inconsistent in our
convention but consistent in another, that convention names the mistake.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.geometry.camera import MODELS, Camera

Array = NDArray[np.float64]

MAX_RESIDUAL_RATIO: Final = 0.5
"""Another convention explains a scene if its residual is below this share of ours, or if our share
of agreeing pixels is below this share of the other convention's."""


def _keep(matrices: Array) -> Array:
    return matrices


def _invert(matrices: Array) -> Array:
    return np.linalg.inv(matrices)


def _transpose(matrices: Array) -> Array:
    result = matrices.copy()
    result[..., :3, :3] = np.swapaxes(matrices[..., :3, :3], -1, -2)
    return result


def _from_centre_to_translation(matrices: Array) -> Array:
    result = matrices.copy()
    result[..., :3, 3] = -np.einsum("...ij,...j->...i", matrices[..., :3, :3], matrices[..., :3, 3])
    return result


def _flip_opengl_axes(matrices: Array) -> Array:
    result = matrices.copy()
    result[..., 1:3, :] *= -1
    return result


def shift_principal_point(camera: Camera, pixels: float) -> Camera:
    """Return the camera with its principal point moved by ``pixels`` along both axes."""
    names = MODELS[camera.model]
    params = tuple(
        p + pixels if name in ("cx", "cy") else p
        for name, p in zip(names, camera.params, strict=True)
    )
    return replace(camera, params=params)


@dataclass(frozen=True)
class Convention:
    """One convention in which a scene may have been written.

    Attributes:
        fault: message for a scene that is consistent only in this convention; empty for our own.
        poses: converts the written poses to cam_from_world, (N, 4, 4).
        principal_shift: pixels to add to the principal point.
        radial_depth: whether depth is the distance along the ray.
    """

    fault: str
    poses: Callable[[Array], Array] = _keep
    principal_shift: float = 0.0
    radial_depth: bool = False


OUR_CONVENTION = Convention("")

POSE_CONVENTIONS = (
    Convention("poses are inverted: world_from_cam where cam_from_world is expected", _invert),
    Convention(
        "rotations are transposed: world_from_cam's, with translations of cam_from_world",
        _transpose,
    ),
    Convention("translations are camera centres, expected t = -R C", _from_centre_to_translation),
    Convention(
        "camera axes are OpenGL's (y up, z backward), expected y down, z forward", _flip_opengl_axes
    ),
)

DEPTH_CONVENTIONS = (
    Convention("depth is the distance along the ray, expected planar z", radial_depth=True),
)

PIXEL_CONVENTIONS = (
    Convention(
        "principal points are half a pixel too small: pixels are counted from the centre of the "
        "first pixel (OpenCV), expected from its corner (COLMAP)",
        principal_shift=0.5,
    ),
    Convention("principal points are half a pixel too large", principal_shift=-0.5),
)

CONVENTIONS = (*POSE_CONVENTIONS, *DEPTH_CONVENTIONS, *PIXEL_CONVENTIONS)


def _roll_quaternions(matrices: Array, roll: int) -> Array:
    """Return the poses with the components of their quaternions rolled by ``roll`` positions."""
    from objconnect.scene.geometry.pose import Pose

    poses = Pose.from_matrix(matrices)
    return np.asarray(
        Pose.from_quaternion(np.roll(poses.quaternion().numpy(), roll, -1), poses.translation)
        .matrix()
        .numpy()
    )


def _roll_inverse_quaternions(matrices: Array, roll: int) -> Array:
    """Roll the quaternions of poses that a file holds as world_from_cam; the centres stay."""
    return _invert(_roll_quaternions(_invert(matrices), roll))


@dataclass(frozen=True)
class PoseConvention:
    """One convention in which the poses of another program may have been written.

    Attributes:
        name: identifier in results files.
        fault: message for poses that agree with their photographs only in this convention.
        poses: converts the stated poses to cam_from_world, (N, 4, 4).
    """

    name: str
    fault: str
    poses: Callable[[Array], Array]


_OPENGL_AXES = "camera axes are turned: y up, z backward (OpenGL) is mistaken for y down, z forward"
_XYZW = "quaternions are x y z w where w x y z is expected"
_WXYZ = "quaternions are w x y z where x y z w is expected"

FOREIGN_CONVENTIONS = (
    PoseConvention("poses-inverted", POSE_CONVENTIONS[0].fault, _invert),
    PoseConvention("rotations-transposed", POSE_CONVENTIONS[1].fault, _transpose),
    PoseConvention(
        "translations-are-centres", POSE_CONVENTIONS[2].fault, _from_centre_to_translation
    ),
    PoseConvention("axes-flipped", _OPENGL_AXES, _flip_opengl_axes),
    # The matrix in the file is inverted, and its reader has converted the axes from OpenGL's.
    PoseConvention(
        "poses-inverted",
        POSE_CONVENTIONS[0].fault,
        lambda m: _flip_opengl_axes(_invert(_flip_opengl_axes(m))),
    ),
    PoseConvention(
        "poses-inverted-axes-flipped",
        f"poses are inverted, and {_OPENGL_AXES}",
        lambda m: _flip_opengl_axes(_invert(m)),
    ),
    PoseConvention(
        "poses-inverted-axes-flipped",
        f"poses are inverted, and {_OPENGL_AXES}",
        lambda m: _invert(_flip_opengl_axes(m)),
    ),
    PoseConvention("quaternion-order", _XYZW, lambda m: _roll_quaternions(m, 1)),
    PoseConvention("quaternion-order", _WXYZ, lambda m: _roll_quaternions(m, -1)),
    PoseConvention("quaternion-order", _XYZW, lambda m: _roll_inverse_quaternions(m, 1)),
    PoseConvention("quaternion-order", _WXYZ, lambda m: _roll_inverse_quaternions(m, -1)),
)
"""Conventions of poses in the files of other programs, and their combinations."""
