"""A session written as a video is read back: pictures, telemetry and truth."""

from __future__ import annotations

import dataclasses
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from objconnect.ingestion.telemetry import read_telemetry
from objconnect.scene.bundle.frames import write_frames
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.errors import InputError
from objconnect.scene.exports.export import export
from objconnect.scene.flights.textfiles import read_poses
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic
from objconnect.scene.geometry.gimbal import gimbal_pose
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.video import decode_frames
from tests.benchmark.made_data import write_scene

pytest.importorskip("av")
pytest.importorskip("srt")
SESSION = "winter-grid"


@pytest.fixture
def made(tmp_path: Path) -> Path:
    return write_scene(tmp_path / "scene")


def change(path: Path, **values: object) -> None:
    """Replace arrays of the session's frames."""
    scene = Scene.open(path)
    frames = dataclasses.replace(scene.frames(SESSION), **values)
    write_frames(path / "sessions" / SESSION / "frames.h5", frames, (), iter(()))
    finish_scene(path, scene.manifest)


def test_a_session_is_written_as_a_video(made: Path, tmp_path: Path) -> None:
    export(made, "video", tmp_path / "out", [SESSION])
    scene = Scene.open(made)
    frames = scene.frames(SESSION)

    shown = list(decode_frames(tmp_path / "out" / f"{SESSION}.MP4"))
    assert [frame.seconds for frame in shown] == pytest.approx([0.0, 1.0, 2.0])
    for frame, name in zip(shown, frames.names, strict=True):
        photograph = read_rgb(scene.images_root / name)
        assert frame.image.shape == photograph.shape
        assert abs(frame.image.astype(float).mean() - photograph.mean()) < 3

    flight = read_telemetry(tmp_path / "out" / f"{SESSION}.SRT")
    assert [item.start_s for item in flight] == pytest.approx([0.0, 1.0, 2.0])
    for k, item in enumerate(flight):
        assert item.place is not None and item.abs_alt is not None and item.gimbal is not None
        at = enu_from_geodetic(Geodetic(*item.place, item.abs_alt), scene.manifest.origin)
        # Six decimals of a degree are 0.11 m.
        np.testing.assert_allclose(at, frames.gps_prior[k], atol=0.06)
        measured = Pose.from_quaternion(frames.attitude_prior[k], np.zeros(3))
        assert float(gimbal_pose(*item.gimbal).error_to(measured)[1]) < 0.1
        assert item.time == datetime(1970, 1, 1, 0, 0, k)

    truth = read_poses(tmp_path / "out" / f"{SESSION}-poses.txt")
    assert list(truth) == [f"{SESSION}-{k:06d}" for k in range(3)]
    for pose, expected in zip(truth.values(), frames.cam_from_world, strict=True):
        np.testing.assert_allclose(pose.matrix().numpy(), expected, atol=1e-9)
    times = (tmp_path / "out" / f"{SESSION}-times.csv").read_text().splitlines()
    assert times[0] == "name,seconds" and times[2] == f"{SESSION}-000001,1.000000"


def test_without_a_fix_a_drone_writes_zeros(made: Path, tmp_path: Path) -> None:
    frames = Scene.open(made).frames(SESSION)
    gps, sigma = frames.gps_prior.copy(), frames.gps_sigma.copy()
    gps[1] = sigma[1] = np.nan
    change(made, gps_prior=gps, gps_sigma=sigma)
    export(made, "video", tmp_path / "out", [SESSION])

    assert "[latitude: 0.000000]" in (tmp_path / "out" / f"{SESSION}.SRT").read_text()
    flight = read_telemetry(tmp_path / "out" / f"{SESSION}.SRT")
    assert [item.place is None for item in flight] == [False, True, False]


@pytest.mark.parametrize(
    ("times", "why"),
    [
        ((0.0, 1.0, 3.0), "not taken at one rate"),
        ((0.0, np.nan, 2.0), "without a time"),
        ((2.0, 1.0, 0.0), "not in the order of their times"),
        ((0.0, 61.0, 122.0), "taken 61 s apart"),
        ((0.0, 0.001, 0.002), "taken 0.001 s apart"),
    ],
)
def test_uneven_times_are_refused(
    made: Path, tmp_path: Path, times: tuple[float, float, float], why: str
) -> None:
    change(made, time=np.array(times))
    with pytest.raises(InputError, match=why):
        export(made, "video", tmp_path / "out", [SESSION])
    assert not (tmp_path / "out").exists()
