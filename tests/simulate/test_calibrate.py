"""The rendered camera is the camera it says it is, as OpenCV sees it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from scene.camera import Camera
from scene.errors import InputError
from simulate.calibrate import BOARD, board_points, board_pose, calibrate

CAMERA = Camera("OPENCV", 400, 300, (346, 348, 198.5, 151.25, -0.15, 0.03, 1e-3, -2e-3))


def test_opencv_recovers_the_camera(tmp_path: Path) -> None:
    result = calibrate(CAMERA, tmp_path, views=8)
    assert len(result.views) == 8
    assert result.rms_px < 0.1
    # Corners lie where the true camera sees them: nothing is half a pixel off.
    assert result.truth_rms_px < 0.12
    assert np.abs(np.divide(result.found.focal, CAMERA.focal) - 1).max() < 2e-3
    assert np.abs(np.subtract(result.found.principal, CAMERA.principal)).max() < 1.0
    assert abs(result.found.distortion[0] - CAMERA.distortion[0]) < 0.02
    assert result.rotation_deg.max() < 0.4
    assert (result.translation_m < 0.01 * result.distance_m).all()
    assert len(list((tmp_path / "views").glob("*.png"))) == 8
    assert (tmp_path / "corners.png").stat().st_size > 20_000
    table = result.text()
    assert "fx" in table
    assert "RMS" in table
    assert result.as_dict()["parameters"]["k1"]["truth"] == -0.15


def test_boards_are_seen_whole() -> None:
    fisheye = Camera("OPENCV_FISHEYE", 320, 240, (170, 171, 158, 121, 0.02, -0.005, 0, 0))
    rng = np.random.default_rng(0)
    for camera in (CAMERA, fisheye):
        for _ in range(20):
            pose = board_pose(camera, BOARD, rng)
            local = board_points(BOARD) @ pose[:3, :3].T + pose[:3, 3]
            xy = camera.project(torch.from_numpy(local)).xy.numpy()
            assert xy.min() > 0
            assert (xy < [camera.width, camera.height]).all()
            assert pose[2, 2] > 0.7  # its face towards the camera


def test_a_camera_too_small_is_one_line(tmp_path: Path) -> None:
    tiny = Camera("PINHOLE", 24, 24, (20.0, 20.0, 12.0, 12.0))
    with pytest.raises(InputError, match="does not see the whole"):
        calibrate(tiny, tmp_path, views=4)
