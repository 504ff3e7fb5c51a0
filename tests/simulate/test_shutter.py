"""A rolling shutter: every row is seen from where the camera is when it is read out."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from objconnect.scene.checks.validate import validate
from objconnect.scene.errors import InputError
from simulate.camera.pinhole import PinholeCamera
from simulate.command import simulate
from simulate.config import SimulateConfig
from simulate.flight.gimbal import camera_centres, velocities
from simulate.render.job import Board, RenderJob, frame_path
from simulate.render.pool import render

CAMERA = PinholeCamera(width=176, height=144, f=150.0, cx=88.0, cy=72.0)
BOARD = Board(columns=9, rows=7, square_m=0.1)
DISTANCE = 0.8
TRAVEL = {1: (0.04, 0.0, 0.0), 2: (-0.03, 0.02, 0.05)}


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, np.ndarray]]:
    """A board straight ahead: of a camera at rest, moving to the right, and moving everywhere."""
    pose = np.eye(4)
    pose[:3, 3] = [-0.4, -0.3, DISTANCE]
    job = RenderJob(
        seed=0, side_m=1, condition="summer-noon", camera=CAMERA, board=BOARD, samples=64,
        poses={k: pose.tolist() for k in range(4)}, travel=TRAVEL,
    )  # fmt: skip
    out = tmp_path_factory.mktemp("shutter")
    render(job, out)
    return [dict(np.load(frame_path(out, k))) for k in range(4)]


def project_corners(travel: tuple[float, ...]) -> np.ndarray:
    """Inner corners (rows, columns, 2), each from where the camera is at the corner's own row."""
    y, x = 0.1 * np.mgrid[: BOARD.rows, : BOARD.columns]
    v = np.full(x.shape, CAMERA.cy)
    for _ in range(20):
        along = v / CAMERA.height - 0.5
        dx, dy, dz = (along * t for t in travel)
        v = CAMERA.f * (y - 0.3 - dy) / (DISTANCE - dz) + CAMERA.cy
    return np.stack([CAMERA.f * (x - 0.4 - dx) / (DISTANCE - dz) + CAMERA.cx, v], -1)


def find_points(picture: np.ndarray, near: np.ndarray) -> np.ndarray:
    grey = cv2.GaussianBlur(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), (0, 0), 1.0)
    start = (near - 0.5).reshape(-1, 1, 2).astype(np.float32)
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-5)
    return cv2.cornerSubPix(grey, start, (6, 6), (-1, -1), stop).reshape(near.shape) + 0.5


def test_edges_lean_as_the_camera_moves(frames) -> None:
    """A camera that moves to the right sees vertical edges lean to the left, by what it travels in
    the readout, velocity x time, from the top to the bottom of the picture."""
    corners = find_points(frames[1]["rgb"], project_corners(TRAVEL[1]))
    lean = np.polyfit(corners[:, 4, 1], corners[:, 4, 0], 1)[0] * CAMERA.height
    print(f"an edge leans by {lean:.3f} px, expected {-CAMERA.f * 0.04 / DISTANCE:.3f} px")
    assert lean == pytest.approx(-CAMERA.f * 0.04 / DISTANCE, abs=0.1)


@pytest.mark.parametrize("frame", range(4))
def test_the_pose_is_that_of_the_middle(frames, frame: int) -> None:
    """Corners are where the camera of their row sees them, and not half a row late."""
    want = project_corners(TRAVEL.get(frame, (0.0, 0.0, 0.0)))
    error = find_points(frames[frame]["rgb"], want) - want
    print(f"frame {frame}: bias {error.mean((0, 1))}, rms {np.sqrt((error**2).sum(-1).mean())} px")
    assert np.abs(error.mean((0, 1))).max() < 0.02
    assert np.sqrt((error**2).sum(-1).mean()) < 0.06


@pytest.mark.parametrize("frame", range(4))
def test_depth_is_of_each_row(frames, frame: int) -> None:
    along = (np.arange(CAMERA.height) + 0.5) / CAMERA.height - 0.5
    want = DISTANCE - along * TRAVEL.get(frame, (0.0, 0.0, 0.0))[2]
    inner = slice(30, 114), slice(60, 116)  # the margin of the board lies 0.1 mm behind it
    assert np.abs(frames[frame]["depth"] - want[:, None])[inner].max() < 1e-6


def test_frames_of_a_camera_at_rest_are_as_before(frames) -> None:
    """Also after others moved."""
    assert np.array_equal(frames[0]["depth"], frames[3]["depth"])


def test_velocities_are_those_of_the_flight() -> None:
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 3] = -np.array([0.0, 6.0, 12.0, 12.0])
    assert camera_centres(poses)[1, 0] == 6
    assert velocities(poses, 2.0)[:, 0].tolist() == [3.0, 3.0, 1.5, 0.0]
    assert not velocities(poses[:1], 2.0).any()


def test_a_scene_says_that_its_rows_have_poses_of_their_own(tmp_path: Path) -> None:
    config = SimulateConfig.load(
        None,
        {"area": 120, "spp": 1, "size": 96, "frames": 3, "sessions": ["summer-noon:nadir:map"],
         "sensor": {"readout_s": 0.03}},
    )  # fmt: skip
    scene = simulate(config, tmp_path / "scene")
    (session,) = scene.manifest.sessions.values()
    assert session.readout_s == 0.03
    checks = {check.name: check for check in validate(tmp_path / "scene").checks}
    (depth,) = [check for name, check in checks.items() if "depth and poses" in name]
    assert "rolling shutter" in depth.detail


def test_a_lens_and_a_rolling_shutter_are_one_line() -> None:
    with pytest.raises(InputError, match="not supported with lens distortion"):
        SimulateConfig.load(
            None, {"sensor": {"readout_s": 0.03}, "camera": {"preset": "phantom-4-rtk-raw"}}
        )
    job = {
        "seed": 0,
        "side_m": 1,
        "condition": "summer-noon",
        "camera": CAMERA,
        "distorted_camera": "x",
    }
    with pytest.raises(ValidationError, match="rolling shutter is not supported"):
        RenderJob(**job, poses={0: np.eye(4).tolist()}, travel={0: (1.0, 0.0, 0.0)})
