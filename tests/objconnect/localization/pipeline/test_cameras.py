"""Which camera a photograph has: every source, and the estimate where there is none."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image
from typer.testing import CliRunner, Result

import objconnect.methods
from benchmark.cli import app
from objconnect.localization.pipeline.cameras import (
    CameraSource,
    add_focal_error,
    calibration_of,
    estimate_camera,
    focal_sigma,
)
from objconnect.scene.colmap.absolute_pose import estimate_absolute_pose
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from objconnect.scene.localizer import Estimate, Query, Status
from objconnect.scene.storage.exif import Exif
from objconnect.scene.storage.xmp import DroneXmp
from tests.benchmark.made_data import CAMERA, FakeLocalizer, pose_at
from tests.objconnect.scene.storage.test_xmp import FIELDS, packet

ORIGIN = Geodetic(47.0, 8.0, 450.0)
# A lens of 30 mm for film 36 mm wide, in a picture 96 pixels wide, as that of the made map.
FOCAL_MM = 30.0


def exif(focal: float | None = None, camera: Camera | None = None) -> Exif:
    return Exif(None, None, "Maker", "Drone", focal, DroneXmp(camera=camera))


def test_the_map_s_camera_of_the_same_size() -> None:
    other = Camera("SIMPLE_RADIAL", 96, 64, (120.0, 48.0, 32.0, 0.0))
    for said in (exif(), exif(FOCAL_MM), exif(32.0)):
        found = calibration_of((96, 64), said, [CAMERA])
        assert (found.camera, found.source, found.others) == (CAMERA, CameraSource.MAP, ())
    # Of several, it is that of the lens.
    assert calibration_of((96, 64), exif(FOCAL_MM), [other, CAMERA]).camera == CAMERA
    assert calibration_of((96, 64), exif(45.0), [CAMERA, other]).camera == other
    unknown = calibration_of((96, 64), exif(), [CAMERA, other])
    assert unknown.source is CameraSource.ESTIMATED
    assert {CAMERA, other} < {unknown.camera, *unknown.others}


def test_the_maker_s_calibration() -> None:
    made = Camera("OPENCV", 5472, 3648, (3660.0, 3650.0, 2730.0, 1870.0, -0.27, 0.1, 1e-4, 1e-4))
    found = calibration_of((2736, 1824), exif(camera=made), [CAMERA])
    assert found.source is CameraSource.CALIBRATED
    assert found.camera.params == (1830.0, 1825.0, 1365.0, 935.0, -0.27, 0.1, 1e-4, 1e-4)
    # It is that of another picture where this one is a part of it.
    cropped = calibration_of((2736, 1539), exif(24.0, made), [CAMERA])
    assert cropped.source is CameraSource.EXIF
    # A lens that is not the map's, in a photograph of the map's size.
    small = Camera("SIMPLE_PINHOLE", 96, 64, (64.0, 48.0, 32.0))
    assert calibration_of((96, 64), exif(24.0, small), [CAMERA]).camera == small


def test_the_map_s_camera_of_another_size() -> None:
    found = calibration_of((192, 128), exif(FOCAL_MM), [CAMERA])
    assert found.source is CameraSource.SCALED
    assert found.camera == Camera("SIMPLE_RADIAL", 192, 128, (160.0, 96.0, 64.0, 0.01))
    # Sides are whole pixels: 64 / 96 of 1000 is 666.67, and a third of a pixel is cut off.
    odd = calibration_of((1000, 667), exif(FOCAL_MM), [CAMERA]).camera
    np.testing.assert_allclose(odd.params, (833.333333, 500.0, 333.5, 0.01), rtol=1e-8)
    # Another aspect ratio, or another lens.
    assert calibration_of((192, 120), exif(FOCAL_MM), [CAMERA]).source is CameraSource.EXIF
    assert calibration_of((192, 128), exif(24.0), [CAMERA]).source is CameraSource.EXIF


def test_the_focal_length_of_exif() -> None:
    found = calibration_of((640, 480), exif(27.0), [CAMERA])
    assert found.source is CameraSource.EXIF
    assert found.camera == Camera("SIMPLE_PINHOLE", 640, 480, (480.0, 320.0, 240.0))
    upright = calibration_of((480, 640), exif(27.0), [CAMERA]).camera
    assert upright.focal == (480.0, 480.0), "the film's width is the longest side"


def contradicting(*focals: float) -> Exif:
    return Exif(None, None, "Maker", "Drone", focals=focals)


def test_fields_that_contradict_each_other_are_tried() -> None:
    """That of the map comes first, for it can be checked, with the map's camera."""
    scaled = Camera("SIMPLE_RADIAL", 192, 128, (160.0, 96.0, 64.0, 0.01))
    found = calibration_of((192, 128), contradicting(3.6, FOCAL_MM / 36), [CAMERA])
    assert (found.camera, found.source) == (scaled, CameraSource.ESTIMATED)
    assert [camera.focal[0] for camera in found.others] == pytest.approx([160.0, 3.6 * 192])
    # No camera of the map is like any of them, or has the shape of the picture.
    for size, cameras in (((192, 128), []), ((192, 108), [CAMERA])):
        found = calibration_of(size, contradicting(0.6, 3.6), cameras)
        focals = [camera.focal[0] for camera in (found.camera, *found.others)]
        assert focals == pytest.approx([0.6 * 192, 3.6 * 192])


@pytest.mark.parametrize("true", [0, 1, 2])
def test_the_map_decides_between_fields(true: int) -> None:
    tried = calibration_of((192, 128), contradicting(3.6, FOCAL_MM / 36), [CAMERA])
    cameras = (tried.camera, *tried.others)

    def localize(query: Query) -> Estimate:
        variance = 1e-8 if query.camera == cameras[true] else 1e-6
        return Estimate(Status.OK, pose_at(1), np.diag([variance] * 6), inliers=50)

    query = Query("a.jpg", np.zeros((128, 192, 3), np.uint8), tried.camera)
    assert estimate_camera(cameras, [query], localize) == cameras[true]


def test_an_uncalibrated_focal_length_is_part_of_the_sigma() -> None:
    pose, covariance = pose_at(1), np.diag([1e-8] * 3 + [0.01] * 3)
    height = float(pose.centre()[2])
    ground = np.array([[x, y, 0.0] for x in range(-90, 91, 3) for y in range(-90, 91, 3)])
    estimate = Estimate(Status.OK, pose, covariance)
    pinhole = Camera("SIMPLE_PINHOLE", 96, 64, (80.0, 48.0, 32.0))
    for camera, source, share in (
        (pinhole, CameraSource.ESTIMATED, 0.06),
        (CAMERA, CameraSource.ESTIMATED, 0.005),
        (pinhole, CameraSource.EXIF, 0.03),
        (pinhole, CameraSource.GIVEN, 0.0),
        (CAMERA, CameraSource.MAP, 0.0),
    ):
        sigma = focal_sigma(camera, source, [CAMERA])
        wider = add_focal_error(estimate, camera, sigma, ground).world_covariance()
        assert wider is not None
        up = float(np.sqrt(wider[2, 2]))
        assert up == pytest.approx(np.hypot(0.1, share * height), rel=0.1)
    lost = Estimate(Status.FAILED)
    assert add_focal_error(lost, CAMERA, 0.06, ground) == lost


@pytest.mark.parametrize("truth", [0.55, 0.8, 1.1])
def test_the_estimate_is_the_lens_that_saw_the_points(truth: float) -> None:
    """PnP on points with relief, seen with 0.5 px of noise by cameras that look down. The focal
    lengths that are tried are 20 % apart."""
    rng = np.random.default_rng(3)
    size = (640, 480)
    camera = Camera("SIMPLE_PINHOLE", *size, (truth * 640, 320.0, 240.0))
    cloud = rng.uniform([-60, -50, 0], [60, 50, 15], (4000, 3))
    observed: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for k in range(3):
        local = pose_at(k).transform(torch.from_numpy(cloud))
        xy = camera.project(local).xy
        seen = camera.contains(xy).numpy()
        observed[f"{k}.jpg"] = (
            xy.numpy()[seen] + rng.normal(size=(seen.sum(), 2)) / 2,
            cloud[seen],
        )
    observed["3.jpg"] = (np.zeros((0, 2)), np.zeros((0, 3)))

    def localize(query: Query) -> Estimate:
        found = estimate_absolute_pose(*observed[query.name], query.camera, 8.0)
        if found is None:
            return Estimate(Status.FAILED)
        inliers = int(found.inliers.sum())
        return Estimate(Status.OK, found.cam_from_world, found.covariance, inliers=inliers)

    tried = calibration_of(size, exif(), [CAMERA])
    assert tried.source is CameraSource.ESTIMATED
    image = np.zeros((480, 640, 3), np.uint8)
    queries = [Query(name, image, tried.camera) for name in observed]
    found = estimate_camera((tried.camera, *tried.others), queries, localize)
    assert found.focal[0] == pytest.approx(truth * 640, rel=0.07)


def test_where_no_photograph_is_found_there_is_some_camera() -> None:
    tried = calibration_of((640, 480), exif(), [CAMERA])
    image = np.zeros((480, 640, 3), np.uint8)
    cameras = (tried.camera, *tried.others)
    lost = estimate_camera(
        cameras, [Query("a.jpg", image, tried.camera)], lambda query: Estimate(Status.FAILED)
    )
    assert lost in cameras


class Remembering(FakeLocalizer):
    """Answers all queries with one pose, and keeps what it was asked."""

    def localize(self, query: Query) -> Estimate:
        super().localize(query)
        # It fits best with the focal length of the map.
        off = abs(np.log(query.camera.focal[0] / max(query.image.shape) / (80 / 96)))
        return Estimate(Status.OK, pose_at(1), np.diag([1e-6 * np.exp(off)] * 6), inliers=50)


@pytest.fixture
def method(monkeypatch: pytest.MonkeyPatch) -> Remembering:
    localizer = Remembering({})
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: localizer)
    return localizer


def write_photograph(
    path: Path, size: tuple[int, int], focal: int | None = None, xmp: bytes = b""
) -> None:
    tags = Image.Exif()
    if focal is not None:
        tags.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = focal
    place = geodetic_from_enu(np.array([5.0, -3.0, 40.0]), ORIGIN)
    gps = tags.get_ifd(ExifTags.IFD.GPSInfo)
    gps[ExifTags.GPS.GPSLatitudeRef], gps[ExifTags.GPS.GPSLongitudeRef] = "N", "E"
    gps[ExifTags.GPS.GPSLatitude] = (place.latitude, 0.0, 0.0)
    gps[ExifTags.GPS.GPSLongitude] = (place.longitude, 0.0, 0.0)
    gps[ExifTags.GPS.GPSAltitude] = place.altitude
    noise = np.random.default_rng(0).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(noise).save(path, exif=tags.tobytes(), xmp=xmp)


def run(place: Path, photographs: Path, out: Path, *more: str) -> Result:
    (place / "origin.json").write_text('{"lat": 47.0, "lon": 8.0, "alt": 450.0}')
    words = ["--map", place, "--images", photographs, "--out", out, *more]
    return CliRunner().invoke(app, ["localize", *map(str, words)])


def table(out: Path) -> dict[str, dict[str, str]]:
    with out.with_suffix(".csv").open(newline="") as stream:
        return {row["name"]: row for row in csv.DictReader(stream)}


def test_the_table_says_which_camera(
    made_flight: Path, tmp_path: Path, method: Remembering, caplog: pytest.LogCaptureFixture
) -> None:
    new, out = tmp_path / "new", tmp_path / "poses.txt"
    shutil.copytree(made_flight / "images", new, ignore=shutil.ignore_patterns("[c-z].jpg"))
    fields = {"CalibratedFocalLength": "50", "CalibratedOpticalCenterX": "40"}
    write_photograph(new / "calibrated.jpg", (80, 80), 22, packet(fields))
    write_photograph(new / "scaled.jpg", (192, 128), 30)
    write_photograph(new / "exif.jpg", (64, 64), 30)
    write_photograph(new / "estimated.jpg", (192, 128))
    answer = run(made_flight, new, out)
    assert answer.exit_code == 0, answer.stderr
    assert "EXIF does not have the focal length of 1 photographs of 192 x 128" in caplog.text
    rows = {name: (row["camera"], row["focal_px"]) for name, row in table(out).items()}
    assert rows["a.jpg"] == rows["b.jpg"] == ("map", "80.0")
    assert rows["calibrated.jpg"] == ("calibrated", "50.0")
    assert rows["scaled.jpg"] == ("scaled", "160.0")
    # Squares have less width for their diagonal than film, whose diagonal is 43.27 mm.
    assert rows["exif.jpg"][0] == "exif"
    assert float(rows["exif.jpg"][1]) == pytest.approx(64 * 30 * 2**0.5 / 43.2666, abs=0.01)
    assert rows["estimated.jpg"] == ("estimated", "160.0"), "as that of the map"
    assert {q.camera.focal[0] for q in method.seen if q.name == "scaled.jpg"} == {160.0}
    words = ("--camera", "PINHOLE 96 64 70 70 48 32")
    assert run(made_flight, made_flight / "images", out, *words).exit_code == 0
    assert {(row["camera"], row["focal_px"]) for row in table(out).values()} == {("given", "70.0")}


def test_fixed_rtk_is_its_own_sigma(made_flight: Path, tmp_path: Path, method: Remembering) -> None:
    high = FIELDS | {"AbsoluteAltitude": "+490.00"}
    write_photograph(tmp_path / "new" / "fixed.jpg", (96, 64), 30, packet(high))
    write_photograph(tmp_path / "new" / "float.jpg", (96, 64), 30, packet(high | {"RtkFlag": "34"}))
    answer = run(made_flight, tmp_path / "new", tmp_path / "poses.txt", "--gps-sigma", "3")
    assert answer.exit_code == 0, answer.stderr
    sigmas = {query.name: query.prior and query.prior.position_sigma for query in method.seen}
    assert sigmas["fixed.jpg"].tolist() == [0.01052, 0.01187, 0.02534]
    assert sigmas["float.jpg"].tolist() == [3, 3, 3]


def test_a_prior_without_an_altitude_tells_no_height(
    made_flight: Path, tmp_path: Path, method: Remembering, caplog: pytest.LogCaptureFixture
) -> None:
    new = tmp_path / "new"
    write_photograph(new / "high.jpg", (96, 64), 30)
    with Image.open(new / "high.jpg") as picture:
        tags = picture.getexif()
        del tags.get_ifd(ExifTags.IFD.GPSInfo)[ExifTags.GPS.GPSAltitude]
        picture.save(new / "flat.jpg", exif=tags.tobytes())
    assert run(made_flight, new, tmp_path / "poses.txt", "--gps-sigma", "3").exit_code == 0
    priors = {query.name: query.prior for query in method.seen}
    flat, high = priors["flat.jpg"], priors["high.jpg"]
    assert flat is not None
    assert high is not None
    np.testing.assert_allclose(flat.position[:2], high.position[:2], atol=1e-3)
    assert flat.position_sigma is not None
    assert flat.position_sigma.tolist() == [3, 3, np.inf]
    assert high.position[2] == pytest.approx(40, abs=0.1)
    assert "flat.jpg: GPSAltitude is missing" in caplog.text
    assert flat.position[2] == pytest.approx(float(pose_at(0).centre()[2]), abs=20)


@pytest.mark.parametrize(
    ("shutter", "speed", "warned"),
    [("Electronic", "9", True), ("Electronic", "2", False), ("Mechanical", "9", False)],
)
def test_a_fast_rolling_shutter_is_one_line(
    made_flight: Path,
    tmp_path: Path,
    method: Remembering,
    shutter: str,
    speed: str,
    warned: bool,
    caplog: pytest.LogCaptureFixture,
) -> None:
    fields = {"ShutterType": shutter, "FlightXSpeed": speed, "FlightYSpeed": "0"}
    for name in ("a.jpg", "b.jpg"):
        write_photograph(tmp_path / "new" / name, (96, 64), 30, packet(fields))
    assert run(made_flight, tmp_path / "new", tmp_path / "poses.txt").exit_code == 0
    lines = [line for line in caplog.messages if "(electronic) shutter" in line]
    assert len(lines) == warned
    assert not warned or ("2 photographs" in lines[0] and "9 m/s" in lines[0])
