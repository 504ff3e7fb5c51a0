from __future__ import annotations

import math

import cv2
import numpy as np
import pycolmap
import pytest
import torch
from torch import Tensor

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.projection import Intrinsics
from tests.objconnect.scene.made_cameras import CAMERAS

every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)


def points_in_view(camera: Camera, n: int = 300) -> Tensor:
    """Points of the camera frame that land inside the picture, at 1 to 100 m, (N, 3)."""
    rng = torch.Generator().manual_seed(0)
    size = torch.tensor([camera.width, camera.height], dtype=torch.float64)
    rays, valid = camera.unproject(torch.rand(n, 2, generator=rng, dtype=torch.float64) * size)
    assert valid.all()
    return rays * (1 + 99 * torch.rand(n, 1, generator=rng, dtype=torch.float64))


@every_camera
def test_every_pixel_comes_back_from_its_ray(camera: Camera) -> None:
    pixels = camera.pixel_grid()[::4, ::4].reshape(-1, 2)
    rays, valid = camera.unproject(pixels)
    projected = camera.project(rays * 7)
    assert valid.all()
    assert projected.valid.all()
    assert (projected.xy - pixels).abs().max() < 1e-4


@every_camera
def test_every_ray_inside_the_limit_comes_back_from_its_pixel(camera: Camera) -> None:
    limit = min(camera.fold_limit(), 1.2)
    radius = torch.linspace(0, 0.95, 40, dtype=torch.float64)[:, None] * limit
    radius = torch.tan(radius) if camera.is_fisheye else radius
    angle = torch.linspace(0, 2 * math.pi, 25, dtype=torch.float64)
    uv = torch.stack([radius * angle.cos(), radius * angle.sin()], -1).reshape(-1, 2)
    rays = torch.cat([uv, torch.ones_like(uv[:, :1])], -1)
    projected = camera.project(rays)
    again, valid = camera.unproject(projected.xy)
    assert valid[projected.valid].all()
    assert projected.valid.double().mean() > 0.9
    assert (again - rays)[projected.valid].abs().max() < 1e-5


@every_camera
def test_agrees_with_colmap(camera: Camera) -> None:
    native = pycolmap.Camera(
        model=camera.model, width=camera.width, height=camera.height, params=list(camera.params)
    )
    points = points_in_view(camera)
    xy = camera.project(points).xy
    np.testing.assert_allclose(xy, native.img_from_cam(points.numpy()), atol=1e-7)
    rays, _ = camera.unproject(xy)
    np.testing.assert_allclose(rays[:, :2], native.cam_from_img(xy.numpy()), atol=1e-6)


@every_camera
def test_agrees_with_opencv_half_a_pixel_away(camera: Camera) -> None:
    points = points_in_view(camera).numpy()
    matrix = camera.calibration.copy()
    matrix[:2, 2] -= 0.5
    still = np.zeros(3)
    if camera.is_fisheye:
        xy, _ = cv2.fisheye.projectPoints(
            points[:, None], still, still, matrix, np.array(camera.distortion)
        )
    else:
        xy, _ = cv2.projectPoints(points, still, still, matrix, np.array(camera.distortion))
    ours = camera.project(torch.from_numpy(points)).xy
    np.testing.assert_allclose(ours, xy[:, 0] + 0.5, atol=1e-7)


@every_camera
def test_jacobian_equals_central_differences(camera: Camera) -> None:
    points = torch.cat([points_in_view(camera, 60), torch.tensor([[0.0, 0.0, 5.0]])])
    jacobian = camera.project(points, jacobian=True).jacobian
    assert jacobian is not None
    step = 1e-6
    for axis in range(3):
        move = torch.zeros(3, dtype=torch.float64)
        move[axis] = step
        ahead, behind = camera.project(points + move).xy, camera.project(points - move).xy
        numeric = (ahead - behind) / (2 * step)
        torch.testing.assert_close(jacobian[..., axis], numeric, rtol=1e-5, atol=1e-4)


@every_camera
def test_jacobian_equals_autograd(camera: Camera) -> None:
    points = torch.cat([points_in_view(camera, 20), torch.tensor([[0.0, 0.0, 5.0]])])
    analytic = camera.project(points, jacobian=True).jacobian
    assert analytic is not None
    full = torch.autograd.functional.jacobian(lambda p: camera.project(p).xy, points)
    own = torch.stack([full[k, :, k] for k in range(len(points))])
    torch.testing.assert_close(analytic, own, rtol=1e-9, atol=1e-9)


@every_camera
def test_points_behind_the_camera_are_never_valid(camera: Camera) -> None:
    points = points_in_view(camera)
    behind = torch.cat([-points, points * torch.tensor([1.0, 1.0, 0.0])])
    projected = camera.project(behind, jacobian=True)
    assert not projected.valid.any()
    assert projected.xy.isfinite().all()
    assert projected.jacobian is not None
    assert projected.jacobian.isfinite().all()


@pytest.mark.parametrize(
    "camera",
    [
        Camera("RADIAL", 640, 480, (500.0, 320.0, 240.0, -0.4, 0.0)),
        # It turns back at 1.04 and grows again beyond 1.70, where points are not valid either.
        Camera("RADIAL", 640, 480, (500.0, 320.0, 240.0, -0.4, 0.05)),
        Camera("OPENCV", 640, 480, (500.0, 510.0, 320.0, 240.0, -0.4, 0.05, 1e-4, -1e-4)),
        Camera("OPENCV_FISHEYE", 640, 480, (280.0, 280.0, 320.0, 240.0, -0.4, 0.0, 0.0, 0.0)),
    ],
    ids=["radial", "radial_turning_twice", "opencv", "fisheye"],
)
def test_nothing_beyond_the_fold_is_valid(camera: Camera) -> None:
    limit = math.tan(camera.fold_limit()) if camera.is_fisheye else camera.fold_limit()
    angle = torch.linspace(0, 2 * math.pi, 33, dtype=torch.float64)
    circle = torch.stack([angle.cos(), angle.sin(), torch.ones_like(angle)], -1)

    def ring(radius: float) -> Tensor:
        return circle * torch.tensor([radius, radius, 1.0])

    assert camera.project(ring(0.99 * limit)).valid.all()
    folded_into_the_picture = 0
    for radius in np.geomspace(1.01 * limit, 1e4, 200):
        projected = camera.project(ring(float(radius)))
        assert not projected.valid.any()
        folded_into_the_picture += int(camera.contains(projected.xy).sum())
    assert folded_into_the_picture > 0  # otherwise the mask would have no effect


@every_camera
def test_valid_points_keep_their_orientation(camera: Camera) -> None:
    """In a very wide field of view, no valid point lies where the distortion folds back."""
    rng = torch.Generator().manual_seed(1)
    wide = torch.randn(20_000, 2, generator=rng, dtype=torch.float64) * 2
    points = torch.cat([wide, torch.ones_like(wide[:, :1])], -1)
    projected = camera.project(points, jacobian=True)
    assert projected.jacobian is not None
    assert (torch.linalg.det(projected.jacobian[..., :2])[projected.valid] > 0).all()


def random_lens(seed: int) -> Camera:
    rng = np.random.default_rng(seed)
    radial, below = rng.uniform(-0.5, 0.5, 3), rng.uniform(-0.5, 0.8, 3)
    lens = (*radial[:2], *rng.uniform(-1e-3, 1e-3, 2), radial[2], *below)
    return Camera("FULL_OPENCV", 640, 480, (500.0, 510.0, 322.0, 237.5, *map(float, lens)))


def rays_within(radius: float, count: int = 200) -> Tensor:
    """Rays (count, 3) with z = 1 up to a radius."""
    rng = np.random.default_rng(0)
    angle, r = rng.uniform(0, 2 * np.pi, count), radius * np.sqrt(rng.uniform(0, 1, count))
    return torch.from_numpy(np.stack([r * np.cos(angle), r * np.sin(angle), np.ones(count)], -1))


@pytest.mark.parametrize("seed", range(60))
def test_random_rational_lenses_agree_with_colmap(seed: int) -> None:
    camera = random_lens(seed)
    native = pycolmap.Camera(model="FULL_OPENCV", width=640, height=480, params=list(camera.params))
    rays = rays_within(min(0.9 * camera.fold_limit(), 1.2))
    found = camera.project(rays)
    assert found.valid.double().mean() > 0.9
    np.testing.assert_allclose(found.xy, native.img_from_cam(rays.numpy()), rtol=1e-9)
    back, valid = camera.unproject(found.xy)
    assert valid[found.valid].all()
    assert (back - rays)[found.valid].abs().max() < 1e-6
    theirs = native.cam_from_img(found.xy.numpy())
    exact = found.valid.numpy() & (np.abs(theirs - rays[:, :2].numpy()) < 1e-4).all(1)
    assert exact.mean() > 0.4  # COLMAP starts from the pixel, and does not always arrive
    np.testing.assert_allclose(back[exact, :2], theirs[exact], atol=1e-4)


@pytest.mark.parametrize("seed", range(60))
def test_a_rational_lens_ends_where_it_folds_or_its_denominator_vanishes(seed: int) -> None:
    camera = random_lens(seed)
    k1, k2, _, _, k3, k4, k5, k6 = camera.distortion

    def distort(r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s = r * r
        below = 1 + k4 * s + k5 * s**2 + k6 * s**3
        return r * (1 + k1 * s + k2 * s**2 + k3 * s**3) / below, below

    limit = camera.fold_limit()
    radius, below = distort(np.linspace(0, min(0.9999 * limit, 50.0), 5000))
    assert (below > 0).all()
    assert (np.diff(radius) > -1e-12 * np.abs(radius[1:])).all()
    if math.isfinite(limit):
        radius, below = distort(limit * np.array([1.0005, 1.002]))
        assert radius[1] < radius[0] or below[0] < 0
        beyond = rays_within(1.0) * torch.tensor([1.0, 1.0, 0.0]).double()
        beyond = beyond / beyond.norm(dim=-1, keepdim=True)
        for far in (1.001, 1.1, 2.0, 10.0):
            rays = far * limit * beyond + torch.tensor([0.0, 0.0, 1.0])
            projected = camera.project(rays.float(), jacobian=True)
            assert not projected.valid.any()
            assert projected.xy.isfinite().all()


def test_points_beyond_a_vanishing_denominator_would_be_in_the_picture() -> None:
    """COLMAP puts them there."""
    params = (500.0, 510.0, 322.0, 237.5, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0)
    camera = Camera("FULL_OPENCV", 640, 480, params)
    assert camera.fold_limit() == pytest.approx(1.0)
    rays = rays_within(1.0) * torch.tensor([9.0, 9.0, 1.0])
    rays = rays[rays[:, :2].norm(dim=-1) > 4.0]
    native = pycolmap.Camera(model="FULL_OPENCV", width=640, height=480, params=list(params))
    assert camera.contains(torch.from_numpy(native.img_from_cam(rays.numpy()))).any()
    assert not camera.project(rays).valid.any()


def test_pixels_no_ray_reaches_are_not_valid() -> None:
    camera = Camera("RADIAL", 640, 480, (500.0, 320.0, 240.0, -0.4, 0.0))
    reach = 500 * (2 / 3) * math.sqrt(1 / 1.2)
    edge = torch.tensor([[320 + 0.99 * reach, 240.0], [320 + 1.01 * reach, 240.0]])
    rays, valid = camera.unproject(edge.double())
    assert valid.tolist() == [True, False]
    assert rays.isfinite().all()


@every_camera
def test_single_precision(camera: Camera) -> None:
    pixels = camera.pixel_grid(torch.float32)[::8, ::8].reshape(-1, 2)
    rays, valid = camera.unproject(pixels)
    projected = camera.project(rays * 30)
    assert rays.dtype == projected.xy.dtype == torch.float32
    assert valid.all()
    assert projected.valid.all()
    assert (projected.xy - pixels).abs().max() < 0.01


@every_camera
def test_single_precision_stays_finite_beside_the_camera(camera: Camera) -> None:
    """Points near the camera plane, such as buildings beside an aircraft, stay finite."""
    side = torch.tensor([[1e3, -1e3], [1e-3, 1e4], [0.0, 1e3]])
    depth = torch.tensor([2e-6, -2e-6, 0.0, 1e-3, -5e3])
    points = torch.cat([side.repeat(5, 1), depth.repeat_interleave(3)[:, None]], -1)
    points.requires_grad_(True)
    projected = camera.project(points, jacobian=True)
    assert projected.xy.isfinite().all()
    assert projected.jacobian is not None
    assert projected.jacobian.isfinite().all()
    torch.where(projected.valid[:, None], projected.xy, 0.0).sum().backward()
    assert points.grad is not None
    assert points.grad.isfinite().all()


@pytest.mark.parametrize("fisheye", [False, True], ids=["perspective", "fisheye"])
def test_a_batch_of_cameras_equals_the_loop(fisheye: bool) -> None:
    cameras = [camera for camera in CAMERAS.values() if camera.is_fisheye == fisheye]
    batch = Intrinsics.stack([camera.intrinsics() for camera in cameras])
    points = torch.stack([points_in_view(camera, 50) for camera in cameras])
    points[:, 0, 2] *= -1
    together = batch.project(points, jacobian=True)
    rays, reached = batch.unproject(together.xy)
    assert together.jacobian is not None
    assert together.xy.shape == (len(cameras), 50, 2)
    for k, camera in enumerate(cameras):
        alone = camera.project(points[k], jacobian=True)
        assert alone.jacobian is not None
        torch.testing.assert_close(together.xy[k], alone.xy)
        torch.testing.assert_close(together.jacobian[k], alone.jacobian)
        assert torch.equal(together.valid[k], alone.valid)
        ray, valid = camera.unproject(alone.xy)
        torch.testing.assert_close(rays[k], ray)
        assert torch.equal(reached[k], valid)


def test_leading_dimensions_of_points() -> None:
    camera = CAMERAS["opencv_strong"]
    points = points_in_view(camera, 60)
    nested = camera.project(points.reshape(3, 4, 5, 3), jacobian=True)
    flat = camera.project(points, jacobian=True)
    assert nested.jacobian is not None
    assert flat.jacobian is not None
    assert torch.equal(nested.xy.reshape(-1, 2), flat.xy)
    assert torch.equal(nested.jacobian.reshape(-1, 2, 3), flat.jacobian)


def test_no_points() -> None:
    projected = CAMERAS["fisheye"].project(torch.zeros(0, 3, dtype=torch.float64), jacobian=True)
    assert projected.xy.shape == (0, 2)
    assert projected.jacobian is not None
    assert projected.jacobian.shape == (0, 2, 3)
