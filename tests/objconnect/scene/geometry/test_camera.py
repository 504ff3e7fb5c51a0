from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import MODELS, Camera
from tests.objconnect.scene.made_cameras import CAMERAS


def test_every_model_is_among_the_tested_cameras() -> None:
    assert {camera.model for camera in CAMERAS.values()} == set(MODELS)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_text_round_trip(camera: Camera) -> None:
    assert Camera.parse(str(camera).split()) == camera


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("EUCM 640 480 1 1 1 1 1 1", "unknown camera model 'EUCM'"),
        ("FULL_OPENCV 640 480 1 1 1 1", "FULL_OPENCV takes 12 parameters"),
        ("PINHOLE 640 480 500 320 240", "takes 4 parameters"),
        ("PINHOLE 640 480 500 500 320 240 0", "takes 4 parameters"),
        ("PINHOLE 640", "expected 'MODEL width height params...'"),
        ("", "expected 'MODEL width height params...'"),
        ("PINHOLE 640 480 five 500 320 240", "expected 'MODEL width height params...'"),
        ("PINHOLE 640 480 nan 500 320 240", "finite"),
        ("PINHOLE 640 480 500 inf 320 240", "finite"),
        ("PINHOLE 640 480 500 0 320 240", "focal length must be positive"),
        ("SIMPLE_PINHOLE 640 480 -500 320 240", "focal length must be positive"),
        ("PINHOLE 0 480 500 500 320 240", "size must be positive"),
        ("PINHOLE 640 -1 500 500 320 240", "size must be positive"),
        ("RADIAL 640 480 500 320 240 1e300 0", "out of range"),
    ],
)
def test_refuses_what_is_no_camera(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Camera.parse(text.split())


def test_first_pixel_centre_is_half() -> None:
    grid = Camera("PINHOLE", 4, 3, (10.0, 10.0, 2.0, 1.5)).pixel_grid()
    assert grid.shape == (3, 4, 2)
    assert grid[0, 0].tolist() == [0.5, 0.5]
    assert grid[2, 3].tolist() == [3.5, 2.5]
    assert grid[0, 1].tolist() == [1.5, 0.5]


def test_contains_the_whole_picture_and_no_more() -> None:
    camera = Camera("PINHOLE", 4, 3, (10.0, 10.0, 2.0, 1.5))
    assert camera.contains(camera.pixel_grid()).all()
    outside = torch.tensor([[-0.1, 1.0], [4.1, 1.0], [1.0, -0.1], [1.0, 3.1]])
    assert not camera.contains(outside).any()
    assert camera.contains(torch.tensor([1.0, 1.0]), border=1.0)
    assert not camera.contains(torch.tensor([0.9, 1.0]), border=1.0)


def test_calibration_matrix_projects_an_undistorted_point() -> None:
    camera = CAMERAS["pinhole"]
    point = np.array([0.3, -0.2, 2.0])
    u, v, w = camera.calibration @ point
    xy = camera.project(torch.from_numpy(point)[None]).xy[0]
    np.testing.assert_allclose(xy, [u / w, v / w])


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_resizing_moves_every_pixel_centre_with_the_picture(camera: Camera) -> None:
    """Halving a picture averages 2 x 2 pixels: the new centre lies at their common corner."""
    half = camera.resize(camera.width // 2, camera.height // 2)
    corners = camera.pixel_grid()[::8, ::8].reshape(-1, 2) + 0.5
    rays, valid = camera.unproject(corners)
    again = half.project(rays)
    assert torch.equal(valid, again.valid)
    assert (again.xy - half.pixel_grid()[::4, ::4].reshape(-1, 2))[valid].abs().max() < 1e-6


def test_resizing_by_two_scales() -> None:
    wide = CAMERAS["pinhole"].resize(1280, 480)
    assert wide.focal == (1000.0, 510.0)
    assert wide.principal == (644.0, 237.5)
    with pytest.raises(InputError, match="one focal length"):
        CAMERAS["simple_radial"].resize(1280, 480)


@pytest.mark.parametrize(
    ("coefficients", "expected"),
    [
        ((0.0, 0.0), math.inf),
        ((0.2, 0.1), math.inf),
        ((-0.4, 0.19), math.inf),  # the slope decreases but stays positive
        ((-0.4, 0.0), math.sqrt(1 / 1.2)),
        ((0.3, -0.1), math.sqrt((0.9 + math.sqrt(0.81 + 2.0)) / 1.0)),
    ],
)
def test_fold_limit_of_known_polynomials(
    coefficients: tuple[float, float], expected: float
) -> None:
    camera = Camera("RADIAL", 640, 480, (500.0, 320.0, 240.0, *coefficients))
    assert camera.fold_limit() == pytest.approx(expected)


def test_fold_limit_of_fisheyes() -> None:
    params = (280.0, 282.0, 322.0, 237.5)
    plain = Camera("OPENCV_FISHEYE", 640, 480, (*params, 0.0, 0.0, 0.0, 0.0))
    folding = Camera("OPENCV_FISHEYE", 640, 480, (*params, -0.5, 0.0, 0.0, 0.0))
    assert plain.fold_limit() == pytest.approx(math.pi / 2)
    assert folding.fold_limit() == pytest.approx(math.sqrt(1 / 1.5))


def test_fold_limit_of_rational_lenses() -> None:
    params = (500.0, 510.0, 320.0, 240.0)

    def limit(k1: float, k2: float, k3: float, *below: float) -> float:
        lens = (k1, k2, 0.0, 0.0, k3, *below)
        return Camera("FULL_OPENCV", 640, 480, (*params, *lens)).fold_limit()

    assert limit(-0.4, 0.0, 0.0, 0.0, 0.0, 0.0) == pytest.approx(math.sqrt(1 / 1.2))
    assert limit(0.0, 0.0, -0.1, 0.0, 0.0, 0.0) == pytest.approx((1 / 0.7) ** (1 / 6))
    assert limit(0.3, 0.1, 0.2, 0.3, 0.1, 0.2) == math.inf
    # r / (1 + r^2) is greatest at 1, and r / (1 - r^2 / 4) has a pole at 2.
    assert limit(0.0, 0.0, 0.0, 1.0, 0.0, 0.0) == pytest.approx(1.0)
    assert limit(0.0, 0.0, 0.0, -0.25, 0.0, 0.0) == pytest.approx(2.0)


small = st.floats(-1, 1)


@given(small, small)
def test_distorted_radius_grows_up_to_the_fold_limit(k1: float, k2: float) -> None:
    limit = Camera("RADIAL", 640, 480, (500.0, 320.0, 240.0, k1, k2)).fold_limit()
    r = np.linspace(0, min(limit, 1e3), 2000)
    distorted = r * (1 + k1 * r**2 + k2 * r**4)
    slope = 1 + 3 * k1 * r**2 + 5 * k2 * r**4
    assert (np.diff(distorted) >= -1e-9 * np.abs(distorted[1:])).all()
    if math.isfinite(limit) and limit < 1e3:
        scale = 1 + abs(3 * k1) * limit**2 + abs(5 * k2) * limit**4
        assert abs(slope[-1]) < 1e-6 * scale


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=8, max_size=8))
def test_any_rational_distortion_is_refused_or_has_a_limit(coefficients: list[float]) -> None:
    try:
        camera = Camera("FULL_OPENCV", 64, 48, (50.0, 50.0, 32.0, 24.0, *coefficients))
    except InputError:
        return
    assert camera.fold_limit() > 0


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=4, max_size=4))
def test_any_distortion_is_refused_or_has_a_limit(coefficients: list[float]) -> None:
    try:
        camera = Camera("OPENCV_FISHEYE", 64, 48, (50.0, 50.0, 32.0, 24.0, *coefficients))
    except InputError:
        return
    assert 0 < camera.fold_limit() <= math.pi / 2
