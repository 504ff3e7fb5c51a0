from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from objconnect.mapping.dense.undistort import pinhole_of, undistort_map, write_undistorted
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.sparse_map import MapImage, SparseMap

BARREL = Camera("OPENCV", 160, 120, (140.0, 141.0, 79.0, 61.0, -0.2, 0.05, 1e-3, -1e-3))
RATIONAL = Camera("FULL_OPENCV", 160, 120, (*BARREL.params, 0.02, 0.2, -0.05, 0.01))
CUSHION = Camera("SIMPLE_RADIAL", 160, 120, (140.0, 80.0, 60.0, 0.15))
FISHEYE = Camera("OPENCV_FISHEYE", 160, 120, (90.0, 90.0, 80.0, 60.0, 0.02, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("camera", [BARREL, RATIONAL, CUSHION, FISHEYE], ids=lambda c: c.model)
def test_the_pinhole_sees_nothing_the_photograph_lacks(camera: Camera) -> None:
    pinhole = pinhole_of(camera, 4000)
    rays, _ = pinhole.unproject(pinhole.pixel_grid())
    seen = camera.project(rays)
    assert seen.valid.all()
    assert camera.contains(seen.xy).all()


def test_size_is_a_limit() -> None:
    assert pinhole_of(BARREL, 80).width == 80
    assert pinhole_of(BARREL, 80).height == 60
    assert pinhole_of(BARREL, 4000).width == 160


def test_a_camera_that_no_pinhole_fits_is_named() -> None:
    off = Camera("SIMPLE_RADIAL", 160, 120, (140.0, 900.0, 60.0, 0.3))
    with pytest.raises(InputError, match="cannot be undistorted"):
        pinhole_of(off, 4000)


def gradient(camera: Camera) -> np.ndarray:
    """A picture whose colour says through which ray it is seen: red is x/z, green is y/z."""
    rays, _ = camera.unproject(camera.pixel_grid())
    rgb = torch.zeros(camera.height, camera.width, 3)
    rgb[..., :2] = 128 + 180 * rays[..., :2]
    return rgb.round().clamp(0, 255).byte().numpy()


@pytest.mark.parametrize("size", [4000, 80])
@pytest.mark.parametrize("camera", [BARREL, RATIONAL], ids=lambda c: c.model)
def test_a_photograph_is_resampled_where_its_rays_go(
    tmp_path: Path, size: int, camera: Camera
) -> None:
    Image.fromarray(gradient(camera)).save(tmp_path / "in.png")
    pinhole = pinhole_of(camera, size)
    write_undistorted(tmp_path / "in.png", camera, pinhole, tmp_path / "out.png")
    found = np.asarray(Image.open(tmp_path / "out.png")).astype(int)
    assert found.shape == (pinhole.height, pinhole.width, 3)
    # 180 grey values a unit of x/z are more than one a pixel: half a pixel off would show.
    off = np.abs(found - gradient(pinhole))[2:-2, 2:-2]
    assert off.max() <= 1


def test_a_pinhole_photograph_is_copied(tmp_path: Path) -> None:
    camera = Camera("SIMPLE_PINHOLE", 160, 120, (140.0, 80.0, 60.0))
    Image.fromarray(gradient(camera)).save(tmp_path / "in.jpg")
    write_undistorted(tmp_path / "in.jpg", camera, pinhole_of(camera, 4000), tmp_path / "out.jpg")
    assert (tmp_path / "out.jpg").read_bytes() == (tmp_path / "in.jpg").read_bytes()


def test_keypoints_follow() -> None:
    xyz = np.array([[1.0, -2.0, 10.0], [3.0, 1.0, 9.0]])
    xy = BARREL.project(torch.from_numpy(xyz)).xy.numpy()
    image = MapImage("a", BARREL, np.eye(4), xy, np.array([0, 1]))
    sparse_map = SparseMap(
        {"a": image}, xyz, np.zeros((2, 3), np.uint8), np.zeros(2), np.ones(2, np.int64)
    )
    pinhole = pinhole_of(BARREL, 80)
    straight = undistort_map(sparse_map, {BARREL: pinhole})
    assert straight.images["a"].camera == pinhole
    assert straight.reprojection_error() < 1e-6
