"""Cameras of a video's frames under zoom, and frames and subtitles that belong together."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from objconnect.ingestion.telemetry import Telemetry
from objconnect.localization.pipeline.cameras import CameraSource
from objconnect.localization.pipeline.footage import (
    Footage,
    FrameCameras,
    Timing,
    cameras_of_frames,
)
from objconnect.localization.pipeline.localization_map import LocalizationMap, open_map
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.storage.video import Video, VideoFrame
from tests.benchmark.made_data import write_scene

SRT = Path("FLIGHT.SRT")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> LocalizationMap:
    return open_map(write_scene(tmp_path_factory.mktemp("place") / "scene"))


def footage(*flight: Telemetry, size: tuple[int, int] = (480, 270)) -> Footage:
    video = Video(*size, rate_hz=10.0, duration_s=float(len(flight)), created=None)
    return Footage(Path("FLIGHT.MP4"), video, SRT, flight, 1.0)


def make_telemetry(second: int, focal_mm: float | None, zoom: float | None = 1.0) -> Telemetry:
    return Telemetry(second, second + 1, rel_alt=1.0, focal_mm=focal_mm, zoom=zoom)


def focals(cameras: FrameCameras, recording: Footage) -> list[float | None]:
    found = [cameras.of(item) for item in recording.telemetry]
    return [None if item is None else item.camera.focal[0] for item in found]


@pytest.mark.parametrize(
    ("zooms", "expected"),
    [
        ([(24.0, 1.0)] * 3, [320, 320, 320]),
        ([(162.0, 1.0)] * 3, [2160, 2160, 2160]),
        ([(24.0, 2.0)] * 3, [640, 640, 640]),
        ([(24.0, 1.0), (24.0, 1.5), (24.0, 2.0)], [320, 480, 640]),
        ([(24.0, 1.0), (48.0, 1.0), (48.0, 2.0)], [320, 640, 1280]),
        ([(24.0, 1.0), (24.0, None), (24.0, 2.0)], [320, None, 640]),
        ([(24.0, 1.0), (None, 1.0), (48.0, 1.0)], [320, None, 640]),
    ],
)
def test_zoom_changes_the_camera_of_a_frame(
    place: LocalizationMap,
    zooms: list[tuple[float | None, float | None]],
    expected: list[float | None],
) -> None:
    recording = footage(*(make_telemetry(k, *zoom) for k, zoom in enumerate(zooms)))
    cameras = cameras_of_frames(recording, None, place)
    assert focals(cameras, recording) == pytest.approx(expected)
    # A frame without subtitles has the camera of all, where they have one.
    after = cameras.of(None)
    is_constant = len(set(expected)) == 1
    assert (after is not None) == is_constant


def test_the_map_s_camera_is_zoomed_about_the_middle(place: LocalizationMap) -> None:
    (own,) = {str(camera): camera for camera in place.cameras}.values()
    lens = 36 * own.focal[0] / max(own.width, own.height)
    recording = footage(
        make_telemetry(0, lens), make_telemetry(1, lens, 2.0), size=(own.width, own.height)
    )
    cameras = cameras_of_frames(recording, None, place)
    first, second = (cameras.of(item) for item in recording.telemetry)
    assert first is not None and second is not None
    assert (first.camera, first.source) == (own, CameraSource.MAP)
    assert second.source is CameraSource.SCALED
    # A ray that the zoom keeps in the picture lies twice as far from its middle.
    ray, middle = np.array([0.02, -0.03]), np.array([own.width / 2, own.height / 2])
    before, after = (
        np.array(camera.focal) * ray + np.array(camera.principal)
        for camera in (first.camera, second.camera)
    )
    np.testing.assert_allclose(after - middle, 2 * (before - middle), rtol=1e-9)


def test_an_unknown_zoom_warns(place: LocalizationMap, caplog: pytest.LogCaptureFixture) -> None:
    recording = footage(make_telemetry(0, 24.0, None), make_telemetry(1, 24.0, None))
    with pytest.raises(InputError, match="dzoom_ratio.*--camera"):
        cameras_of_frames(recording, None, place)
    (own,) = {str(camera): camera for camera in place.cameras}.values()
    recording = footage(
        make_telemetry(0, None, None), make_telemetry(1, None, None), size=(own.width, own.height)
    )
    cameras = cameras_of_frames(recording, None, place)
    assert focals(cameras, recording) == [own.focal[0]] * 2
    assert any("zoom is unknown" in line for line in caplog.messages)


def test_a_given_camera_is_that_of_all_frames(
    place: LocalizationMap, caplog: pytest.LogCaptureFixture
) -> None:
    given = Camera("SIMPLE_PINHOLE", 480, 270, (300.0, 240.0, 135.0))
    recording = footage(make_telemetry(0, 24.0), make_telemetry(1, 48.0))
    with caplog.at_level(logging.WARNING):
        assert focals(cameras_of_frames(recording, given, place), recording) == [300.0, 300.0]
    assert any("24.0 to 48.0 mm" in line for line in caplog.messages)


def test_another_lens_than_the_map_s_warns(
    place: LocalizationMap, caplog: pytest.LogCaptureFixture
) -> None:
    (own,) = {str(camera): camera for camera in place.cameras}.values()
    recording = footage(make_telemetry(0, 300.0), size=(own.width, own.height))
    found = cameras_of_frames(recording, None, place).of(recording.telemetry[0])
    assert found is not None and found.source is CameraSource.EXIF
    assert any("focal length of 300.0 mm, which is used" in line for line in caplog.messages)


def enumerate_lines(count: int, step_s: float) -> list[Telemetry]:
    return [
        Telemetry(k * step_s, (k + 1) * step_s, rel_alt=float(k), frame=k + 1) for k in range(count)
    ]


@pytest.mark.parametrize(
    ("step_s", "duration_s", "rate_hz", "height"),
    [
        # The same rate, also where the subtitles end before the video.
        (1 / 30, 4.0, 30.0, 30),
        (0.033, 8.0, 30.0, 30),
        # Slow motion: 120 subtitles a second, shown at 30 frames a second.
        (1 / 120, 4.0, 30.0, 30),
        # A subtitle every second, of a video of 30 frames a second.
        (1.0, 120.0, 30.0, 1),
        # Nothing agrees.
        (1 / 120, 9.0, 30.0, None),
    ],
)
def test_frames_and_subtitles_belong_together(
    step_s: float, duration_s: float, rate_hz: float, height: float | None
) -> None:
    flight = enumerate_lines(120, step_s)
    video = Video(480, 270, rate_hz, duration_s, None)
    frame = VideoFrame(30, 30 / rate_hz + 1e-4, np.zeros((1, 1, 3), np.uint8))
    found = Timing.of(flight, video).telemetry_of(flight, frame)
    assert (found and found.rel_alt) == height


def test_subtitles_without_numbers_hold_by_their_times() -> None:
    flight = [replace(item, frame=None) for item in enumerate_lines(120, 1 / 120)]
    timing = Timing.of(flight, Video(480, 270, 30.0, 4.0, None))
    assert timing == Timing()


def test_pixels_that_are_not_square_need_a_camera(place: LocalizationMap) -> None:
    recording = footage(make_telemetry(0, 24.0))
    recording = replace(recording, video=replace(recording.video, pixel_aspect=4 / 3))
    with pytest.raises(InputError, match=r"1\.333 times as wide as high: give its calibration"):
        cameras_of_frames(recording, None, place)
    given = Camera("SIMPLE_PINHOLE", 480, 270, (320.0, 240.0, 135.0))
    assert cameras_of_frames(recording, given, place).is_given
