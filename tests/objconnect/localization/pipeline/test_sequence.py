"""``localize --video`` and ``--sequence``: priors, times, records, interruptions and refusals."""

from __future__ import annotations

import csv
import json
import shutil
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

import objconnect.methods
from benchmark.cli import app
from objconnect.ingestion.telemetry import Telemetry
from objconnect.localization.pipeline.frames import TelemetryReader
from objconnect.localization.pipeline.localization_map import open_map
from objconnect.localization.pipeline.options import LocalizeOptions
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.exports.export import export
from objconnect.scene.flights.textfiles import read_poses
from objconnect.scene.geometry.geodesy import geodetic_from_enu
from objconnect.scene.geometry.gimbal import gimbal_pose
from objconnect.scene.localizer import Estimate, Status
from objconnect.scene.storage.exif import Exif, write_jpeg
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.video import write_video
from tests.benchmark.made_data import CAMERA, FakeLocalizer, pose_at, write_scene

pytest.importorskip("av")
pytest.importorskip("srt")
SESSION = "winter-grid"
NAMES = [f"{SESSION}-{k:06d}" for k in range(3)]
COVARIANCE = 1e-4 * np.eye(6)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return write_scene(tmp_path / "scene")


@pytest.fixture
def video(scene: Path, tmp_path: Path) -> Path:
    """Three frames at 1 Hz, each with GPS and gimbal in the subtitles beside it."""
    export(scene, "video", tmp_path / "flown", [SESSION])
    return tmp_path / "flown" / f"{SESSION}.MP4"


@pytest.fixture
def method(video: Path, monkeypatch: pytest.MonkeyPatch) -> FakeLocalizer:
    truth = read_poses(video.with_name(f"{SESSION}-poses.txt"))
    answers = {name: Estimate(Status.OK, truth[name], COVARIANCE, inliers=9) for name in NAMES}
    localizer = FakeLocalizer(answers)
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: localizer)
    return localizer


def run(*words: object) -> Result:
    return CliRunner().invoke(app, ["localize", *map(str, words)])


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as stream:
        return list(csv.DictReader(stream))


def test_a_video_becomes_a_track(
    scene: Path, video: Path, method: FakeLocalizer, tmp_path: Path
) -> None:
    out, geojson = tmp_path / "track.txt", tmp_path / "track.geojson"
    words = ("--map", scene, "--video", video, "--rate", 1, "--out", out, "--undulation", 0)
    answer = run(*words, "--also", geojson)
    assert answer.exit_code == 0, answer.stderr
    assert answer.stdout == f"{out}: 3 of 3 frames found\n"

    truth = read_poses(video.with_name(f"{SESSION}-poses.txt"))
    found = read_poses(out)
    assert list(found) == NAMES
    assert all(float(found[name].error_to(truth[name])[0]) < 1e-6 for name in NAMES)
    rows = rows_of(out.with_suffix(".csv"))
    assert [float(row["seconds"]) for row in rows] == [0.0, 1.0, 2.0]
    assert [row["time"] for row in rows] == [f"1970-01-01T00:00:0{k}.000" for k in range(3)]
    assert len(json.loads(geojson.read_text())["features"]) == 3

    record = json.loads(out.with_suffix(".json").read_text())
    assert record["video"] == video.name and record["srt"] == f"{SESSION}.SRT"
    assert (record["images"], record["found"], record["rate_hz"]) == (3, 3, 1.0)
    assert record["sequence"]["lost_after"] == 4 and record["method"]["name"] == "fake"
    assert not list(tmp_path.glob(".objconnect*"))


def test_first_telemetry_then_motion_is_the_prior(
    scene: Path, video: Path, method: FakeLocalizer, tmp_path: Path
) -> None:
    words = ("--map", scene, "--video", video, "--rate", 1, "--out", tmp_path / "t.txt")
    assert run(*words, "--undulation", 0, "--gps-sigma", 3, "--gimbal-sigma", 4).exit_code == 0
    frames = open_map(scene)
    priors = [query.prior for query in method.seen]
    assert len(priors) == 3 and all(prior is not None for prior in priors)
    first, second = priors[0], priors[1]
    assert first is not None and first.position_sigma is not None and second is not None
    assert first.position_sigma.tolist() == [3, 3, 3] and first.attitude_sigma_deg == 4
    # The session's GPS is off by a metre along each axis (``write_scene``).
    truth = read_poses(video.with_name(f"{SESSION}-poses.txt"))
    np.testing.assert_allclose(first.position, truth[NAMES[0]].centre().numpy() + 1, atol=0.06)
    # The motion begins at the first pose, with no velocity.
    np.testing.assert_allclose(second.position, truth[NAMES[0]].centre().numpy(), atol=1e-9)
    assert frames.origin is not None


def test_subtitles_are_optional(
    scene: Path, video: Path, method: FakeLocalizer, tmp_path: Path
) -> None:
    video.with_suffix(".SRT").unlink()
    out = tmp_path / "t.txt"
    assert run("--map", scene, "--video", video, "--rate", 1, "--out", out).exit_code == 0
    assert method.seen[0].prior is None
    assert json.loads(out.with_suffix(".json").read_text())["srt"] is None
    assert [row["time"] for row in rows_of(out.with_suffix(".csv"))] == ["", "", ""]


def test_an_interrupted_track_goes_on(
    scene: Path, video: Path, method: FakeLocalizer, tmp_path: Path
) -> None:
    words = ("--map", scene, "--video", video, "--rate", 1)
    assert run(*words, "--out", tmp_path / "whole.txt").exit_code == 0
    told = [query.prior for query in method.seen]

    answers = dict(method.answers)
    method.answers = answers | {NAMES[2]: KeyboardInterrupt()}
    assert run(*words, "--out", tmp_path / "t.txt").exit_code != 0
    assert not (tmp_path / "t.txt").exists()
    method.answers, method.seen = answers, []
    assert run(*words, "--out", tmp_path / "t.txt").exit_code == 0
    assert [query.name for query in method.seen] == [NAMES[2]]
    again, before = method.seen[0].prior, told[2]
    assert again is not None and before is not None
    np.testing.assert_array_equal(again.position, before.position)
    for ending in (".txt", ".csv"):
        made = (tmp_path / "t.txt").with_suffix(ending).read_text()
        assert made == (tmp_path / "whole.txt").with_suffix(ending).read_text()


def test_another_image_before_changes_all_after(
    scene: Path, video: Path, method: FakeLocalizer, tmp_path: Path
) -> None:
    """Poses depend on those before: the journal of another video is not taken."""
    words = ("--map", scene, "--video", video, "--rate", 1, "--out", tmp_path / "t.txt")
    answers = dict(method.answers)
    method.answers = answers | {NAMES[2]: KeyboardInterrupt()}
    assert run(*words).exit_code != 0
    frames = [np.full((CAMERA.height, CAMERA.width, 3), 9 * k, np.uint8) for k in range(3)]
    write_video(video, frames, 1.0)
    method.answers, method.seen = answers, []
    assert run(*words).exit_code == 0
    assert [query.name for query in method.seen] == NAMES


def test_options_of_the_sequence(
    scene: Path, video: Path, method: FakeLocalizer, tmp_path: Path
) -> None:
    out = tmp_path / "t.txt"
    words = ("--map", scene, "--video", video, "--rate", 1, "--out", out)
    assert (
        run(*words, "--set", "sequence.motion.speed=4", "--set", "sequence.gate=9").exit_code == 0
    )
    config = json.loads(out.with_suffix(".json").read_text())["sequence"]
    assert (config["motion"]["speed"], config["gate"]) == (4.0, 9.0)
    refused = run(*words, "--set", "sequence.gates=9")
    assert refused.exit_code == 2 and "gates" in refused.stderr


def folder_of(scene: Path, folder: Path, times: list[datetime | None]) -> Path:
    """The photographs of the session with other times, under names in another order."""
    folder.mkdir()
    for k, time in enumerate(times):
        pixels = read_rgb(scene / "sessions" / SESSION / "images" / f"{k:06d}.jpg")
        write_jpeg(folder / f"{9 - k}.jpg", pixels, Exif(None, time))
    return folder


def test_photographs_are_taken_in_the_order_of_their_times(
    scene: Path, method: FakeLocalizer, tmp_path: Path
) -> None:
    times = [datetime(2024, 1, 1, 12, 0, k) for k in (0, 1, 3)]
    folder = folder_of(scene, tmp_path / "new", list(times))
    method.answers = {f"{9 - k}.jpg": Estimate(Status.OK, pose_at(k), COVARIANCE) for k in range(3)}
    out = tmp_path / "t.txt"
    answer = run("--map", scene, "--images", folder, "--sequence", "--out", out)
    assert answer.exit_code == 0, answer.stderr
    rows = rows_of(out.with_suffix(".csv"))
    assert [row["name"] for row in rows] == ["9.jpg", "8.jpg", "7.jpg"]
    assert [float(row["seconds"]) for row in rows] == [0.0, 1.0, 3.0]
    assert method.seen[0].prior is None and method.seen[1].prior is not None


def test_photographs_without_times_need_a_rate(
    scene: Path, method: FakeLocalizer, tmp_path: Path
) -> None:
    folder = folder_of(scene, tmp_path / "new", [None, None, None])
    words = ("--map", scene, "--images", folder, "--sequence", "--out", tmp_path / "t.txt")
    refused = run(*words)
    assert refused.exit_code == 2 and "give --rate" in refused.stderr
    assert refused.stderr.count("\n") == 1
    assert run(*words, "--rate", 0.5).exit_code == 0
    rows = rows_of(tmp_path / "t.csv")
    assert [(row["name"], float(row["seconds"])) for row in rows] == [
        ("7.jpg", 0.0),
        ("8.jpg", 2.0),
        ("9.jpg", 4.0),
    ]


def test_a_photograph_that_cannot_be_read_is_a_row(
    scene: Path, method: FakeLocalizer, tmp_path: Path
) -> None:
    times = [datetime(2024, 1, 1, 12, 0, k) for k in range(3)]
    folder = folder_of(scene, tmp_path / "new", list(times))
    (folder / "8.jpg").write_bytes(b"nothing")
    method.answers = {"9.jpg": Estimate(Status.OK, pose_at(0), COVARIANCE)}
    assert (
        run("--map", scene, "--images", folder, "--sequence", "--out", tmp_path / "t.txt").exit_code
        == 0
    )
    rows = {row["name"]: row for row in rows_of(tmp_path / "t.csv")}
    assert rows["9.jpg"]["status"] == "ok"
    assert rows["8.jpg"]["status"] == "failed" and "8.jpg" in rows["8.jpg"]["reason"]


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ((), "--images, or a video"),
        (("--video", "VIDEO", "--images", "."), "--images, or a video"),
        (("--video", "VIDEO", "--sequence"), "leave out"),
        (("--images", ".", "--srt", "VIDEO"), "--srt"),
        (("--images", ".", "--rate", "2"), "--sequence"),
        (("--video", "missing.mp4"), "cannot read video"),
    ],
)
def test_options_that_do_not_belong_together(
    scene: Path,
    video: Path,
    method: FakeLocalizer,
    tmp_path: Path,
    words: tuple[str, ...],
    reason: str,
) -> None:
    given = [str(video) if word == "VIDEO" else word for word in words]
    refused = run("--map", scene, "--out", tmp_path / "t.txt", *given)
    assert refused.exit_code == 2 and reason in refused.stderr
    assert not (tmp_path / "t.txt").exists()


def test_inputs_are_not_replaced(
    scene: Path, video: Path, method: FakeLocalizer, tmp_path: Path
) -> None:
    shutil.copy(video, tmp_path / "t.json")
    refused = run("--map", scene, "--video", tmp_path / "t.json", "--out", tmp_path / "t.txt")
    assert refused.exit_code == 2 and "another output" in refused.stderr


def test_the_camera_of_a_video(scene: Path, method: FakeLocalizer, tmp_path: Path) -> None:
    """Given, else that of the map, else of the focal length in the telemetry."""
    path, srt = tmp_path / "small.mp4", tmp_path / "small.srt"
    write_video(path, [np.zeros((40, 48, 3), np.uint8)] * 2, 1.0)
    words = ("--map", scene, "--video", path, "--out", tmp_path / "t.txt")
    refused = run(*words)
    assert refused.exit_code == 2 and "has no focal length" in refused.stderr
    refused = run(*words, "--camera", "SIMPLE_PINHOLE 64 48 50 32 24")
    assert refused.exit_code == 2 and "48 x 40" in refused.stderr
    assert run(*words, "--camera", "SIMPLE_PINHOLE 48 40 50 24 20").exit_code == 0
    assert method.seen[-1].camera.params == (50, 24, 20)

    srt.write_text("1\n00:00:00,000 --> 00:00:01,000\n[focal_len: 24.00] [rel_alt: 9.0]\n")
    assert run(*words).exit_code == 0
    assert method.seen[-1].camera.focal[0] == pytest.approx(24 / 36 * 48)
    assert rows_of(tmp_path / "t.csv")[0]["camera"] == "exif"


def test_priors_of_telemetry(scene: Path) -> None:
    place, options = open_map(scene), LocalizeOptions(gps_sigma_m=2.0)
    assert place.origin is not None
    fix = geodetic_from_enu(np.array([12.0, -7.0, 60.0]), place.origin)
    said = Telemetry(0, 1, (fix.latitude, fix.longitude), abs_alt=fix.altitude - 48)
    known = TelemetryReader(place, options, undulation_m=48.0)(said)
    assert known is not None and known.position_sigma is not None
    np.testing.assert_allclose(known.position, [12, -7, 60], atol=1e-6)
    assert known.position_sigma.tolist() == [2, 2, 2]

    # Without the geoid the altitude is not known: the map's cameras have one to begin with.
    reader = TelemetryReader(place, options, undulation_m=None)
    level = reader(said)
    assert level is not None and level.position_sigma is not None
    np.testing.assert_allclose(level.position[:2], [12, -7], atol=0.01)
    assert level.position_sigma.tolist() == [2, 2, np.inf]
    heights = [image.pose.centre()[2].item() for image in place.sparse_map.images.values()]
    assert level.position[2] == pytest.approx(np.median(heights))

    gimbal = reader(Telemetry(0, 1, gimbal=(30.0, -80.0, 0.0)))
    assert gimbal is not None and not gimbal.has_position and gimbal.has_heading
    expected = gimbal_pose(30.0, -80.0, 0.0).rotation.numpy()
    np.testing.assert_allclose(gimbal.cam_from_world_rotation, expected)
    assert reader(Telemetry(0, 1, rel_alt=60.0)) is None
    # Latitude and longitude exchanged: another country, not a prior.
    assert reader(Telemetry(0, 1, (fix.longitude, fix.latitude))) is None


def test_a_rendered_flight_is_found(rendered: Scene, tmp_path: Path) -> None:
    """From rendering through H.264 and subtitles to poses, with a method that really looks."""
    session = "summer-noon-nadir-query"
    export(rendered.path, "video", tmp_path / "flown", [session])
    video, out = tmp_path / "flown" / f"{session}.MP4", tmp_path / "track.txt"
    words = ("--map", rendered.path, "--video", video, "--method", "sift", "--undulation", 0)
    answer = run(*words, "--rate", 1, "--out", out)
    assert answer.exit_code == 0, answer.stderr
    truth, found = read_poses(video.with_name(f"{session}-poses.txt")), read_poses(out)
    assert list(found) == list(truth)
    for name, pose in found.items():
        metres, degrees = pose.error_to(truth[name])
        assert float(metres) < 0.5 and float(degrees) < 1


def test_a_frame_s_doubts_are_in_its_row(
    scene: Path, video: Path, method: FakeLocalizer, tmp_path: Path
) -> None:
    """The latitude of one subtitle is not a number."""
    srt = video.with_suffix(".SRT")
    texts = srt.read_text().split("\n\n")
    texts[1] = texts[1].replace("[latitude: ", "[latitude: 4x")
    srt.write_text("\n\n".join(texts))
    out = tmp_path / "t.txt"
    answer = run("--map", scene, "--video", video, "--rate", 1, "--out", out)
    assert answer.exit_code == 0, answer.stderr
    reasons = [row["reason"] for row in rows_of(out.with_suffix(".csv"))]
    assert reasons[0] == reasons[2] == "" and reasons[1].startswith("latitude 4x")
