"""Rigid poses: ``a_from_b`` maps points of frame b into frame a.

Rotations are matrices, so that composition and application are matrix products that support
autograd and batches. Quaternions appear only in files.

The tangent vector of a pose is ``(omega, v)``: rotation (rad) then translation (m), applied on the
left: ``exp(delta) @ pose``. All Jacobians and covariances of the project use this order.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

# Below this angle (rad) the closed forms lose digits and their Taylor series are exact in float64.
_SMALL_ANGLE = 1e-4


def skew(v: Tensor) -> Tensor:
    """Return the matrix [v]x with ``[v]x w = v x w``. (..., 3) -> (..., 3, 3)."""
    zero = torch.zeros_like(v[..., 0])
    x, y, z = v.unbind(-1)
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return torch.stack(rows, -1).reshape(*v.shape[:-1], 3, 3)


def _series(theta: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return sin(t)/t, (1-cos t)/t^2, (t-sin t)/t^3; values and gradients at zero are finite."""
    small = theta < _SMALL_ANGLE
    t = torch.where(small, torch.ones_like(theta), theta)
    t2 = theta * theta
    a = torch.where(small, 1 - t2 / 6, torch.sin(t) / t)
    b = torch.where(small, 0.5 - t2 / 24, 2 * torch.sin(t / 2) ** 2 / t**2)
    c = torch.where(small, 1 / 6 - t2 / 120, (t - torch.sin(t)) / t**3)
    return a, b, c


def _norm(v: Tensor) -> Tensor:
    """Return the Euclidean norm over the last axis; its gradient at zero is zero, not NaN."""
    squared = (v * v).sum(-1)
    positive = squared > 0
    return torch.where(positive, torch.where(positive, squared, 1).sqrt(), 0 * squared)


def so3_exp(omega: Tensor) -> Tensor:
    """Return the rotation by |omega| rad about omega (Rodrigues). (..., 3) -> (..., 3, 3)."""
    theta = _norm(omega)[..., None, None]
    a, b, _ = _series(theta)
    W = skew(omega)
    eye = torch.eye(3, dtype=omega.dtype, device=omega.device)
    return eye + a * W + b * (W @ W)


def so3_log(rotation: Tensor) -> Tensor:
    """Return the rotation vector (rad, norm at most pi) of a rotation. (..., 3, 3) -> (..., 3).

    It goes through the quaternion, which keeps full precision near 0 and near pi.
    """
    q = quaternion_from_rotation(rotation)
    w, xyz = q[..., :1], q[..., 1:]
    sine = _norm(xyz)[..., None]
    small = sine < _SMALL_ANGLE
    safe = torch.where(small, torch.ones_like(sine), sine)
    scale = torch.where(
        small, 2 / w.clamp_min(0.5) - (2 / 3) * sine**2, 2 * torch.atan2(sine, w) / safe
    )
    return scale * xyz


def rotation_from_quaternion(wxyz: Tensor) -> Tensor:
    """Return the rotation of a quaternion w x y z of any length. (..., 4) -> (..., 3, 3)."""
    q = wxyz / wxyz.norm(dim=-1, keepdim=True)
    w, x, y, z = q.unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    return torch.stack(rows, -1).reshape(*wxyz.shape[:-1], 3, 3)


def quaternion_from_rotation(rotation: Tensor) -> Tensor:
    """Return the unit quaternion w x y z, w >= 0 (Shepperd's method). (..., 3, 3) -> (..., 4)."""
    m = rotation
    d0, d1, d2 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    trace = d0 + d1 + d2
    # Row k is the quaternion times 4 times its k-th component; the largest is best conditioned.
    w_row = [1 + trace, m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0]]
    w_row += [m[..., 1, 0] - m[..., 0, 1]]
    x_row = [w_row[1], 1 + 2 * d0 - trace, m[..., 0, 1] + m[..., 1, 0]]
    x_row += [m[..., 0, 2] + m[..., 2, 0]]
    y_row = [w_row[2], x_row[2], 1 + 2 * d1 - trace, m[..., 1, 2] + m[..., 2, 1]]
    z_row = [w_row[3], x_row[3], y_row[3], 1 + 2 * d2 - trace]
    table = torch.stack([torch.stack(r, -1) for r in (w_row, x_row, y_row, z_row)], -2)
    best = torch.diagonal(table, dim1=-2, dim2=-1).argmax(-1)
    index = best[..., None, None].expand(*best.shape, 1, 4)
    q = table.gather(-2, index).squeeze(-2)
    q = q / q.norm(dim=-1, keepdim=True)
    return torch.where(q[..., :1] < 0, -q, q)


@dataclass(frozen=True)
class Pose:
    """A rigid transform ``a_from_b``, or a batch of them.

    Attributes:
        rotation: rotation matrices, (..., 3, 3).
        translation: translations, (..., 3) metres.

    Examples:
        >>> cam_from_world = Pose.from_quaternion([1, 0, 0, 0], [0.0, 0.0, 5.0])
        >>> cam_from_world.transform(torch.zeros(1, 3, dtype=torch.float64)).tolist()
        [[0.0, 0.0, 5.0]]
        >>> (cam_from_world @ cam_from_world.inverse()).translation.tolist()
        [0.0, 0.0, 0.0]
        >>> metres, degrees = cam_from_world.error_to(Pose.identity())
        >>> float(metres), float(degrees)
        (5.0, 0.0)
    """

    rotation: Tensor
    translation: Tensor

    @staticmethod
    def identity(dtype: torch.dtype = torch.float64, device: torch.device | None = None) -> Pose:
        """Return the identity transform."""
        rotation = torch.eye(3, dtype=dtype, device=device)
        return Pose(rotation, torch.zeros(3, dtype=dtype, device=device))

    @staticmethod
    def from_matrix(matrix: object) -> Pose:
        """Make poses from homogeneous matrices (..., 4, 4) or (..., 3, 4), array or tensor."""
        m = torch.as_tensor(matrix)
        return Pose(m[..., :3, :3], m[..., :3, 3])

    @staticmethod
    def from_quaternion(wxyz: object, translation: object) -> Pose:
        """Make poses from quaternions w x y z (..., 4) of any length and translations (..., 3)."""
        q = torch.as_tensor(wxyz, dtype=torch.float64)
        return Pose(rotation_from_quaternion(q), torch.as_tensor(translation, dtype=torch.float64))

    @staticmethod
    def exp(delta: Tensor) -> Pose:
        """Return the SE(3) exponential of a tangent (omega, v). (..., 6) -> Pose."""
        omega, v = delta[..., :3], delta[..., 3:]
        theta = _norm(omega)[..., None, None]
        _, b, c = _series(theta)
        W = skew(omega)
        eye = torch.eye(3, dtype=delta.dtype, device=delta.device)
        V = eye + b * W + c * (W @ W)
        return Pose(so3_exp(omega), (V @ v[..., None])[..., 0])

    def log(self) -> Tensor:
        """Return the SE(3) logarithm: the tangent (..., 6) with ``Pose.exp(tangent) == self``."""
        omega = so3_log(self.rotation)
        theta = _norm(omega)[..., None, None]
        a, b, _ = _series(theta)
        W = skew(omega)
        eye = torch.eye(3, dtype=omega.dtype, device=omega.device)
        # V^-1 = I - W/2 + (1 - a/(2b)) / theta^2 W^2, where the last factor tends to 1/12 at zero.
        small = theta < _SMALL_ANGLE
        t2 = torch.where(small, torch.ones_like(theta), theta * theta)
        k = torch.where(small, torch.full_like(theta, 1 / 12), (1 - a / (2 * b)) / t2)
        v = ((eye - 0.5 * W + k * (W @ W)) @ self.translation[..., None])[..., 0]
        return torch.cat([omega, v], -1)

    def matrix(self) -> Tensor:
        """Return homogeneous matrices (..., 4, 4)."""
        top = torch.cat([self.rotation, self.translation[..., None]], -1)
        last = torch.zeros_like(top[..., :1, :])
        last[..., 3] = 1
        return torch.cat([top, last], -2)

    def quaternion(self) -> Tensor:
        """Return unit quaternions w x y z with w >= 0, (..., 4)."""
        return quaternion_from_rotation(self.rotation)

    def inverse(self) -> Pose:
        """Return ``b_from_a``."""
        transposed = self.rotation.transpose(-1, -2)
        return Pose(transposed, -(transposed @ self.translation[..., None])[..., 0])

    def __matmul__(self, other: Pose) -> Pose:
        """Compose transforms: ``a_from_b @ b_from_c = a_from_c``."""
        rotation = self.rotation @ other.rotation
        rotated = (self.rotation @ other.translation[..., None])[..., 0]
        return Pose(rotation, rotated + self.translation)

    def transform(self, points: Tensor) -> Tensor:
        """Map points of frame b into frame a. Pose (...), points (..., N, 3) -> (..., N, 3)."""
        return points @ self.rotation.transpose(-1, -2) + self.translation[..., None, :]

    def centre(self) -> Tensor:
        """Return the origin of frame a in frame b, (..., 3): for ``cam_from_world``, its centre."""
        return -(self.rotation.transpose(-1, -2) @ self.translation[..., None])[..., 0]

    def to(self, *, dtype: torch.dtype | None = None, device: torch.device | None = None) -> Pose:
        """Return the same pose in another precision or on another device."""
        return Pose(
            self.rotation.to(dtype=dtype, device=device),
            self.translation.to(dtype=dtype, device=device),
        )

    def error_to(self, truth: Pose) -> tuple[Tensor, Tensor]:
        """Return the distance of the camera centres (m) and the angle between the rotations (deg).

        Both have the batch shape (...). The angle is the norm of the rotation vector, because the
        trace is inexact below a thousandth of a degree.
        """
        metres = (self.centre() - truth.centre()).norm(dim=-1)
        relative = so3_log(self.rotation @ truth.rotation.transpose(-1, -2))
        return metres, torch.rad2deg(relative.norm(dim=-1))


def transform_jacobian(points_in_a: Tensor) -> Tensor:
    """Return d(point in a) / d(tangent of a_from_b), left perturbation. (..., 3) -> (..., 3, 6)."""
    eye = torch.eye(3, dtype=points_in_a.dtype, device=points_in_a.device)
    return torch.cat([-skew(points_in_a), eye.expand(*points_in_a.shape[:-1], 3, 3)], -1)
