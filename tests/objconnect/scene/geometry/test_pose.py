from __future__ import annotations

import math

import numpy as np
import pycolmap
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from objconnect.scene.geometry.pose import (
    Pose,
    quaternion_from_rotation,
    rotation_from_quaternion,
    skew,
    so3_exp,
    so3_log,
    transform_jacobian,
)

ANGLES = [0.0, 1e-300, 1e-12, 1e-8, 9.9e-5, 1.01e-4, 1.9e-4, 0.3, 2.0, 3.1, math.pi - 1e-5]
NEAR_PI = [math.pi - 1e-9, math.pi, math.pi + 1e-9]


def random_poses(n: int, seed: int = 0) -> Pose:
    rng = torch.Generator().manual_seed(seed)
    q = torch.randn(n, 4, generator=rng, dtype=torch.float64)
    return Pose.from_quaternion(q, 10 * torch.randn(n, 3, generator=rng, dtype=torch.float64))


def axes(n: int = 12) -> Tensor:
    """Unit vectors, the coordinate axes among them, (N, 3)."""
    rng = torch.Generator().manual_seed(3)
    random = torch.randn(n, 3, generator=rng, dtype=torch.float64)
    eye = torch.eye(3, dtype=torch.float64)
    both = torch.cat([eye, -eye, random])
    return both / both.norm(dim=-1, keepdim=True)


def close(a: Pose, b: Pose, atol: float = 1e-12) -> None:
    torch.testing.assert_close(a.matrix(), b.matrix(), rtol=0, atol=atol)


def test_skew_is_the_cross_product() -> None:
    a, b = axes()[:5], axes()[5:10]
    torch.testing.assert_close((skew(a) @ b[..., None])[..., 0], torch.linalg.cross(a, b))


def test_exp_turns_a_quarter() -> None:
    quarter = so3_exp(torch.tensor([0.0, 0.0, math.pi / 2], dtype=torch.float64))
    expected = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], dtype=torch.float64)
    torch.testing.assert_close(quarter, expected)


@pytest.mark.parametrize("angle", [*ANGLES, *NEAR_PI])
def test_exp_equals_the_matrix_exponential(angle: float) -> None:
    omega = axes() * angle
    torch.testing.assert_close(
        so3_exp(omega), torch.linalg.matrix_exp(skew(omega)), rtol=0, atol=1e-13
    )
    v = torch.tensor([3.0, -20.0, 100.0], dtype=torch.float64).expand_as(omega)
    twist = torch.zeros(len(omega), 4, 4, dtype=torch.float64)
    twist[:, :3, :3], twist[:, :3, 3] = skew(omega), v
    torch.testing.assert_close(
        Pose.exp(torch.cat([omega, v], -1)).matrix(),
        torch.linalg.matrix_exp(twist),
        rtol=0,
        atol=1e-11,
    )


@pytest.mark.parametrize("angle", ANGLES)
def test_log_inverts_exp(angle: float) -> None:
    omega = axes() * angle
    torch.testing.assert_close(so3_log(so3_exp(omega)), omega, rtol=1e-10, atol=1e-15)
    delta = torch.cat([omega, 5 * axes().flip(0)], -1)
    torch.testing.assert_close(Pose.exp(delta).log(), delta, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("angle", [*ANGLES, *NEAR_PI])
def test_exp_inverts_log(angle: float) -> None:
    """Beyond pi the logarithm is a different vector that gives the same rotation."""
    pose = Pose.exp(torch.cat([axes() * angle, 5 * axes().flip(0)], -1))
    tangent = pose.log()
    assert (tangent[:, :3].norm(dim=-1) <= math.pi + 1e-12).all()
    close(Pose.exp(tangent), pose, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 9.9e-5, 1.1e-4, 1e-3, 0.5, 3.0])
def test_exp_and_log_in_single_precision(angle: float) -> None:
    delta = torch.cat([axes() * angle, axes().flip(0)], -1).float()
    again = Pose.exp(delta).log()
    assert again.dtype == torch.float32
    torch.testing.assert_close(again, delta, rtol=1e-5, atol=2e-6)


def test_gradients_at_the_identity() -> None:
    zero = torch.zeros(6, dtype=torch.float64)
    round_trip = torch.autograd.functional.jacobian(lambda d: Pose.exp(d).log(), zero)
    torch.testing.assert_close(round_trip, torch.eye(6, dtype=torch.float64))
    points = axes()
    moved = torch.autograd.functional.jacobian(lambda d: Pose.exp(d).transform(points), zero)
    torch.testing.assert_close(moved, transform_jacobian(points))
    rotation = torch.eye(3, dtype=torch.float64)
    assert torch.autograd.functional.jacobian(so3_log, rotation).isfinite().all()


def test_gradients_of_the_error_to_itself_are_not_nan() -> None:
    delta = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    pose = random_poses(1)
    metres, degrees = (Pose.exp(delta[None]) @ pose).error_to(pose)
    (metres + degrees).sum().backward()
    assert delta.grad is not None
    assert delta.grad.isfinite().all()


def test_transform_jacobian_equals_central_differences() -> None:
    pose, points = random_poses(1), 30 * axes()
    moved = pose.transform(points)[0]
    jacobian = transform_jacobian(moved)
    step = 1e-6
    for k in range(6):
        delta = torch.zeros(1, 6, dtype=torch.float64)
        delta[0, k] = step
        ahead = (Pose.exp(delta) @ pose).transform(points)[0]
        behind = (Pose.exp(-delta) @ pose).transform(points)[0]
        torch.testing.assert_close(
            jacobian[..., k], (ahead - behind) / (2 * step), rtol=1e-6, atol=1e-6
        )


def test_group_laws() -> None:
    a, b, c = random_poses(8, 1), random_poses(8, 2), random_poses(8, 3)
    identity = Pose.identity()
    close((a @ b) @ c, a @ (b @ c))
    close(a @ identity, a)
    close(identity @ a, a)
    close(a @ a.inverse(), Pose.exp(torch.zeros(8, 6, dtype=torch.float64)))
    close((a @ b).inverse(), b.inverse() @ a.inverse())
    points = axes().expand(8, -1, 3)
    torch.testing.assert_close((a @ b).transform(points), a.transform(b.transform(points)))


def test_matrix_round_trip_and_action() -> None:
    pose = random_poses(5)
    close(Pose.from_matrix(pose.matrix()), pose, 0)
    close(Pose.from_matrix(pose.matrix().numpy()[:, :3]), pose, 0)
    points = axes()
    homogeneous = torch.cat([points, torch.ones_like(points[:, :1])], -1)
    expected = (pose.matrix()[:, None] @ homogeneous[..., None])[..., :3, 0]
    torch.testing.assert_close(pose.transform(points.expand(5, -1, 3)), expected)


def test_centre_is_the_point_the_camera_sees_at_its_origin() -> None:
    pose = random_poses(7)
    at_origin = pose.transform(pose.centre()[:, None])[:, 0]
    assert at_origin.abs().max() < 1e-12
    torch.testing.assert_close(pose.centre(), pose.inverse().translation)


components = st.floats(-1, 1, allow_subnormal=False)


@given(st.tuples(components, components, components, components))
def test_quaternion_round_trip(wxyz: tuple[float, float, float, float]) -> None:
    q = torch.tensor(wxyz, dtype=torch.float64)
    if q.norm() < 1e-3:
        return
    q = q / q.norm()
    rotation = rotation_from_quaternion(q)
    torch.testing.assert_close(
        rotation @ rotation.T, torch.eye(3, dtype=torch.float64), rtol=0, atol=1e-14
    )
    assert float(torch.linalg.det(rotation)) == pytest.approx(1)
    again = quaternion_from_rotation(rotation)
    assert again[0] >= 0
    assert min((again - q).abs().max(), (again + q).abs().max()) < 1e-14


def test_quaternions_are_w_first_where_pycolmap_has_w_last() -> None:
    poses = random_poses(20)
    for k, (w, x, y, z) in enumerate(poses.quaternion().tolist()):
        native = pycolmap.Rotation3d(np.array([x, y, z, w]))
        np.testing.assert_allclose(poses.rotation[k], native.matrix(), atol=1e-14)


def test_a_quaternion_of_any_length_is_normalised() -> None:
    q = random_poses(4).quaternion()
    zeros = torch.zeros(4, 3, dtype=torch.float64)
    close(Pose.from_quaternion(5 * q, zeros), Pose.from_quaternion(-q, zeros))


@pytest.mark.parametrize("degrees", [1e-6, 1e-3, 0.1, 2.0, 90.0, 179.9999, 180.0])
def test_error_is_right_at_every_size(degrees: float) -> None:
    truth = random_poses(18)
    turn = Pose.exp(torch.cat([axes() * math.radians(degrees), torch.zeros(18, 3)], -1))
    shift = torch.tensor([2e-6, -1e-6, 2e-6], dtype=torch.float64)
    turned = turn @ truth  # about the camera: its centre stays
    moved = Pose(turned.rotation, turned.translation - turned.rotation @ shift)
    metres, angle = moved.error_to(truth)
    torch.testing.assert_close(angle, torch.full_like(angle, degrees), rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(metres, torch.full_like(metres, 3e-6), rtol=1e-6, atol=0)
    back_metres, back_angle = truth.error_to(moved)
    torch.testing.assert_close(back_metres, metres)
    torch.testing.assert_close(back_angle, angle)


def test_error_to_itself_is_zero() -> None:
    pose = random_poses(10)
    metres, degrees = pose.error_to(pose)
    assert metres.max() < 1e-12
    assert degrees.max() < 1e-12


def test_batches_equal_the_loop() -> None:
    a, b = random_poses(6, 1), random_poses(6, 2)
    points = torch.randn(6, 9, 3, dtype=torch.float64)
    metres, degrees = a.error_to(b)
    for k in range(6):
        one, other = Pose(a.rotation[k], a.translation[k]), Pose(b.rotation[k], b.translation[k])
        close(one @ other, Pose.from_matrix((a @ b).matrix()[k]))
        close(one.inverse(), Pose.from_matrix(a.inverse().matrix()[k]))
        torch.testing.assert_close(a.log()[k], one.log())
        torch.testing.assert_close(a.quaternion()[k], one.quaternion())
        torch.testing.assert_close(a.transform(points)[k], one.transform(points[k]))
        m, d = one.error_to(other)
        torch.testing.assert_close(torch.stack([metres[k], degrees[k]]), torch.stack([m, d]))


def test_to_changes_the_precision() -> None:
    pose = random_poses(2).to(dtype=torch.float32)
    assert pose.rotation.dtype == pose.translation.dtype == torch.float32
