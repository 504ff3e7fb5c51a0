"""OpenCV recovers a simulated camera from rendered views of a chessboard."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import MODELS, Camera
from simulate.calibration import BOARD, board_points, board_pose, calibrate

pytestmark = pytest.mark.thorough

CAMERA = Camera("OPENCV", 400, 300, (346, 348, 198.5, 151.25, -0.15, 0.03, 1e-3, -2e-3))
FISHEYE = Camera("OPENCV_FISHEYE", 320, 240, (165, 164, 162, 118, 0.03, -0.008, 2e-3, 0))


@pytest.mark.parametrize(
    ("camera", "views"),
    [
        (CAMERA, 10),
        pytest.param(FISHEYE, 20, marks=pytest.mark.slow),
        pytest.param(Camera("PINHOLE", 320, 240, (290, 290, 158, 121)), 20, marks=pytest.mark.slow),
        pytest.param(Camera("PINHOLE", 512, 512, (443, 443, 256, 256)), 20, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_opencv_recovers_the_camera(camera: Camera, views: int, tmp_path: Path) -> None:
    """The targets of the project, on cameras that nothing was tuned on."""
    result = calibrate(camera, tmp_path, views, seed=3)
    print(result.text())
    assert len(result.views) >= 0.9 * views
    assert result.rms_px < 0.1
    # Corners lie where the true camera sees them: nothing is half a pixel off.
    assert result.truth_rms_px < 0.1
    assert np.abs(np.divide(result.estimated.focal, camera.focal) - 1).max() < 1e-3
    assert np.abs(np.subtract(result.estimated.principal, camera.principal)).max() < 0.5
    assert abs(result.estimated.distortion[0] - camera.distortion[0]) < 0.02
    assert result.rotation_deg.max() < 0.3
    assert (result.translation_m < 0.005 * result.distance_m).all()
    assert len(list((tmp_path / "views").glob("*.png"))) == views
    assert (tmp_path / "corners.png").stat().st_size > 20_000
    table = result.text()
    assert "RMS" in table
    for name, value in zip(MODELS[camera.model], camera.params, strict=True):
        assert name in table
        assert result.as_dict()["parameters"][name]["truth"] == value


def test_boards_are_seen_whole() -> None:
    rng = np.random.default_rng(0)
    for camera in (CAMERA, FISHEYE):
        for _ in range(20):
            pose = board_pose(camera, BOARD, rng)
            local = board_points(BOARD) @ pose[:3, :3].T + pose[:3, 3]
            xy = camera.project(torch.from_numpy(local)).xy.numpy()
            assert xy.min() > 0
            assert (xy < [camera.width, camera.height]).all()
            assert pose[2, 2] > 0.6  # its face towards the camera


def test_a_camera_too_small_is_one_line(tmp_path: Path) -> None:
    tiny = Camera("PINHOLE", 24, 24, (20.0, 20.0, 12.0, 12.0))
    with pytest.raises(InputError, match="cannot see the whole"):
        calibrate(tiny, tmp_path, views=4)
