"""What localize writes for autopilots, robots and surveyors, read back by their own libraries."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import objconnect.methods
from objconnect.localization.pipeline.answers import (
    Geography,
    ImageEstimate,
    encode_files,
    output_files,
)
from objconnect.scene.bundle.georeference import EXACT_GEOREFERENCE as EXACT
from objconnect.scene.bundle.georeference import Georeference
from objconnect.scene.geo.crs import Projection, geoid_undulation
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from objconnect.scene.localizer import Estimate, Status
from objconnect.scene.storage.outputs import check_outputs
from tests.benchmark.made_data import QUERY_NAMES, FakeLocalizer, pose_at, write_flight
from tests.benchmark.test_cli import error_line, invoke
from tests.geoid import installed_geoid
from tests.objconnect.localization.pipeline.test_answers import looking

pyproj = pytest.importorskip("pyproj")
mavutil = pytest.importorskip("pymavlink.mavutil")
highlevel = pytest.importorskip("rosbags.highlevel")

YAW, PITCH, ROLL = 30.0, -60.0, 4.0
ORIGIN = Geodetic(47.0, 8.0, 450.0)
PLACE = geodetic_from_enu(np.array([10.0, 20.0, 30.0]), ORIGIN)
UNDULATION = 48.5
TIMES = [datetime(2026, 1, 2, 3, 4, 5, 678_000, UTC), datetime(2026, 1, 2, 3, 4, 4, tzinfo=UTC)]
SECONDS = 1767323045.678  # of the first, by `date -u -d 2026-01-02T03:04:05.678 +%s.%3N`


def locate() -> list[ImageEstimate]:
    return [
        ImageEstimate("b.jpg", looking(YAW, PITCH, ROLL), PLACE, TIMES[0]),
        ImageEstimate("a.jpg", looking(0, -90, 0, covariance=False), PLACE, TIMES[1]),
        ImageEstimate("no time.jpg", looking(0, -90, 0), PLACE),
        ImageEstimate("lost.jpg", Estimate(Status.FAILED, reason="too dark"), None, TIMES[0]),
        ImageEstimate("fallback.jpg", Estimate(Status.FALLBACK, pose_at(0)), PLACE, TIMES[0]),
    ]


def write(folder: Path, geography: Geography, *endings: str) -> list[Path]:
    files = output_files(folder / "poses.txt", [folder / f"poses.{ending}" for ending in endings])
    for path, content in encode_files(locate(), files, geography):
        path.write_bytes(content)
    check_outputs(files)  # all of them are recognized as files of ours
    return [file.path for file in files[2:]]


def euler(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """The quaternion w x y z of turns about z, then y, then x, by the formula of textbooks."""
    cy, cp, cr = (math.cos(math.radians(angle) / 2) for angle in (yaw, pitch, roll))
    sy, sp, sr = (math.sin(math.radians(angle) / 2) for angle in (yaw, pitch, roll))
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def same_rotation(first: Any, second: Any) -> None:
    assert abs(np.dot(first, second)) == pytest.approx(1, abs=1e-6)


def messages(path: Path) -> list[Any]:
    """The messages of a telemetry log, as ground stations read them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MAVLINK20", "1")  # mavutil sets it and leaves it
        log = mavutil.mavlink_connection(str(path), dialect="common")
    found = []
    while (message := log.recv_match()) is not None:
        found.append(message)
    assert log.mav.total_receive_errors == 0
    return found


def test_missing_times_are_warned_of_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write(tmp_path, Geography(UNDULATION, None, EXACT), "tlog", "mcap")
    assert caplog.text.count("1 of 3 photographs have no time") == 1
    caplog.clear()
    write(tmp_path, Geography(UNDULATION, None, EXACT), "geojson", "kml")
    assert "have no time" not in caplog.text


def test_mavlink(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (path,) = write(tmp_path, Geography(UNDULATION, None, EXACT), "tlog")
    assert "1 of 3 photographs have no time" in caplog.text
    text, before, _, position, odometry = messages(path)
    assert text.text == "poses by objconnect localize"
    assert [m.get_seq() for m in messages(path)] == [0, 1, 2, 3, 4]
    assert before.time_usec < position.time_usec == odometry.time_usec == round(SECONDS * 1e6)
    assert position._timestamp == pytest.approx(SECONDS, abs=1e-5)
    assert position.get_type() == "GLOBAL_POSITION_SENSOR"
    assert position.source == 2, "GLOBAL_POSITION_SRC_VISION"
    assert (position.lat, position.lon) == (round(PLACE[0] * 1e7), round(PLACE[1] * 1e7))
    assert position.alt_ellipsoid == pytest.approx(PLACE.altitude, abs=1e-3)
    assert position.alt_ellipsoid - position.alt == pytest.approx(UNDULATION, abs=1e-3)
    covariance = locate()[0].covariance
    assert covariance is not None
    assert position.eph == pytest.approx(math.sqrt(covariance[0, 0] + covariance[1, 1]))
    assert position.epv == pytest.approx(math.sqrt(covariance[2, 2]))
    assert math.isnan(before.eph)

    assert odometry.get_type() == "ODOMETRY"
    assert odometry.frame_id == 1, "MAV_FRAME_LOCAL_NED"
    assert odometry.child_frame_id == 12, "MAV_FRAME_BODY_FRD"
    # East 10, north 20, up 30; yaw is from north clockwise, pitch and roll as of an aircraft.
    np.testing.assert_allclose([odometry.x, odometry.y, odometry.z], [20, 10, -30], atol=1e-5)
    same_rotation(odometry.q, euler(YAW, PITCH, ROLL))
    axis, sign = [1, 0, 2, 4, 3, 5], [1, 1, -1, 1, 1, -1]
    upper = [
        sign[i] * sign[j] * covariance[axis[i], axis[j]] for i in range(6) for j in range(i, 6)
    ]
    np.testing.assert_allclose(odometry.pose_covariance, upper, rtol=1e-5)
    assert math.isnan(messages(path)[2].pose_covariance[0])
    assert math.isnan(odometry.vx) and math.isnan(odometry.velocity_covariance[0])


def test_both_accuracies_in_mavlink(tmp_path: Path) -> None:
    """The position on earth is as exact as the map's place there, the local one as before."""
    covariance = locate()[0].covariance
    assert covariance is not None
    for number, placed in enumerate([Georeference(horizontal_m=5, source="stated"), None]):
        (tmp_path / str(number)).mkdir()
        (path,) = write(tmp_path / str(number), Geography(georeference=placed), "tlog")
        position, odometry = messages(path)[3:5]
        if placed is None:
            assert math.isnan(position.eph)
        else:
            across = covariance[0, 0] + covariance[1, 1] + 25
            assert position.eph == pytest.approx(math.sqrt(across))
        assert math.isnan(position.epv), "how exact the height of the map is on earth is unknown"
        assert odometry.pose_covariance[0] == pytest.approx(covariance[1, 1]), "within the map"


def test_both_accuracies_in_ros(tmp_path: Path) -> None:
    covariance = locate()[0].covariance
    assert covariance is not None
    placed = Georeference(horizontal_m=5, vertical_m=2, source="gps")
    (tmp_path / "a").mkdir()
    poses = {}
    for name, georeference in (("a", placed), ("b", None)):
        (tmp_path / name).mkdir(exist_ok=True)
        (path,) = write(tmp_path / name, Geography(georeference=georeference), "mcap")
        with highlevel.AnyReader([path]) as reader:
            for connection, _, data in reader.messages():
                message = reader.deserialize(data, connection.msgtype)
                poses[f"{name}{connection.topic}"] = message  # the last one has a covariance
    stamped = poses["a/objconnect/fix"]
    assert stamped.position_covariance_type == stamped.COVARIANCE_TYPE_KNOWN
    on_earth = covariance[:3, :3] + np.diag([12.5, 12.5, 4])
    np.testing.assert_allclose(stamped.position_covariance.reshape(3, 3), on_earth)
    stamped = poses["b/objconnect/fix"]
    assert stamped.position_covariance_type == stamped.COVARIANCE_TYPE_UNKNOWN
    assert not stamped.position_covariance.any()
    for name in "ab":
        within = poses[f"{name}/objconnect/pose"].pose.covariance.reshape(6, 6)
        np.testing.assert_allclose(within, covariance)


def test_without_the_geoid_mavlink_has_the_ellipsoid_alone(tmp_path: Path) -> None:
    (path,) = write(tmp_path, Geography(), "tlog")
    position = messages(path)[3]
    assert position.alt_ellipsoid == pytest.approx(PLACE.altitude, abs=1e-3)
    assert math.isnan(position.alt)


def test_ros(tmp_path: Path) -> None:
    (path,) = write(tmp_path, Geography(UNDULATION, None, EXACT), "mcap")
    read: dict[str, list[tuple[int, Any]]] = {}
    with highlevel.AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            read.setdefault(connection.topic, []).append((time, message))
    assert read["/objconnect/made_by"][0][1].data == "poses by objconnect localize"
    (_, before), (time, stamped) = read["/objconnect/fix"]
    assert (
        time
        == stamped.header.stamp.sec * 10**9 + stamped.header.stamp.nanosec
        == round(SECONDS * 1e3) * 10**6
    )
    assert (stamped.latitude, stamped.longitude, stamped.altitude) == PLACE, "above the ellipsoid"
    covariance = locate()[0].covariance
    assert covariance is not None
    assert stamped.position_covariance_type == stamped.COVARIANCE_TYPE_KNOWN
    np.testing.assert_allclose(stamped.position_covariance.reshape(3, 3), covariance[:3, :3])
    assert before.position_covariance_type == before.COVARIANCE_TYPE_UNKNOWN
    ((_, pose),) = read["/objconnect/pose"]  # zeros would be certainty
    assert (pose.header.frame_id, pose.header.stamp) == ("map", stamped.header.stamp)
    at, turned = pose.pose.pose.position, pose.pose.pose.orientation
    np.testing.assert_allclose([at.x, at.y, at.z], [10, 20, 30], atol=1e-9)
    # REP 103: yaw is from east counter-clockwise, and a nose that points down has positive pitch.
    same_rotation([turned.w, turned.x, turned.y, turned.z], euler(90 - YAW, -PITCH, ROLL))
    np.testing.assert_allclose(pose.pose.covariance.reshape(6, 6), covariance)


def test_nothing_found_is_an_empty_log(tmp_path: Path) -> None:
    files = output_files(tmp_path / "p.txt", [tmp_path / "p.tlog", tmp_path / "p.mcap"])
    for path, content in encode_files(locate()[3:], files, Geography()):
        path.write_bytes(content)
    assert len(messages(tmp_path / "p.tlog")) == 1
    with highlevel.AnyReader([tmp_path / "p.mcap"]) as reader:
        assert [connection.topic for connection, _, _ in reader.messages()] == [
            "/objconnect/made_by"
        ]


def test_heights_differ_by_the_undulation_in_every_format(tmp_path: Path) -> None:
    geography = Geography(UNDULATION, Projection("EPSG:32632"))
    geojson, kml, tlog, mcap = write(tmp_path, geography, "geojson", "kml", "tlog", "mcap")
    row = next(csv.DictReader((tmp_path / "poses.csv").open(newline="")))
    feature = json.loads(geojson.read_text())["features"][0]
    point = next(ElementTree.parse(kml).getroot().iter("{http://www.opengis.net/kml/2.2}Point"))
    sensor = messages(tlog)[3]
    with highlevel.AnyReader([mcap]) as reader:
        poses = [c for c in reader.connections if c.topic == "/objconnect/fix"]
        ros = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(poses)][1]
    ellipsoidal = [
        float(row["altitude"]),
        float(row["h"]),
        feature["geometry"]["coordinates"][2],
        sensor.alt_ellipsoid,
        ros.altitude,
    ]
    above_sea = [
        float(row["sea_level_m"]),
        feature["properties"]["sea_level_m"],
        float(point[1].text.split(",")[2]),
        sensor.alt,
    ]
    np.testing.assert_allclose(ellipsoidal, PLACE.altitude, atol=2e-3)
    np.testing.assert_allclose(above_sea, PLACE.altitude - UNDULATION, atol=2e-3)
    assert row["h_above"] == "ellipsoid"


@pytest.mark.parametrize(
    "code", ["EPSG:32632", "EPSG:25832", "EPSG:2056", "EPSG:4326", "EPSG:3857"]
)
def test_columns_in_another_system(tmp_path: Path, code: str) -> None:
    write(tmp_path, Geography(None, Projection(code)))
    row, *others = csv.DictReader((tmp_path / "poses.csv").open(newline=""))
    direct = pyproj.Transformer.from_crs("EPSG:4979", code, always_xy=True)
    expected = direct.transform(PLACE.longitude, PLACE.latitude, PLACE.altitude)
    np.testing.assert_allclose([float(row[c]) for c in "xyh"], expected, atol=1e-4)
    assert row["crs"] == pyproj.CRS(code).name
    (lost,) = (other for other in others if other["name"] == "lost.jpg")
    assert lost["x"] == lost["y"] == lost["h"] == lost["crs"] == ""


def test_east_is_first() -> None:
    """The central meridian of a zone of UTM has the easting 500 km, the equator the northing 0."""
    utm = Projection("EPSG:32632")
    np.testing.assert_allclose(utm.from_geodetic(Geodetic(0.0, 9.0, 7.0)), [5e5, 0, 7], atol=1e-6)


@pytest.fixture
def geoid(tmp_path: Path) -> Iterator[float]:
    """Height of the geoid above the ellipsoid everywhere, metres."""
    with installed_geoid(tmp_path) as undulation_m:
        yield undulation_m


def test_the_geoid_of_an_installed_grid(geoid: float) -> None:
    assert geoid_undulation(PLACE) == pytest.approx(geoid)
    above_sea = Projection("EPSG:4326+5773")
    assert above_sea.height_reference == "EGM96 height"
    assert above_sea.from_geodetic(PLACE)[2] == pytest.approx(PLACE.altitude - geoid)


def test_without_a_grid_nothing_is_guessed() -> None:
    assert geoid_undulation(PLACE) is None


@pytest.fixture
def meadow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[object, ...]:
    """Words of a command whose method finds one photograph."""
    localizer = FakeLocalizer({"b.jpg": Estimate(Status.OK, pose_at(1), inliers=50)})
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: localizer)
    flight = write_flight(tmp_path / "meadow")
    (flight / "origin.json").write_text('{"lat": 47.0, "lon": 8.0, "alt": 450.0}')
    new = tmp_path / "new"
    new.mkdir()
    for name in QUERY_NAMES:
        (new / name).write_bytes((flight / "images" / name).read_bytes())
    return ("localize", "--map", flight, "--images", new, "--out", tmp_path / "poses.txt")


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("EPSG:99999", "is not a coordinate reference system"),
        ("EPSG:4978", "has no eastings and northings"),
        ("EPSG:5773", "has no eastings and northings"),
        ("EPSG:7415", "need the grid nl_nsgi_nlgeo2018.tif"),
        ("\x1b[31m", "is not a coordinate reference system"),
    ],
)
def test_systems_that_cannot_be_written(
    meadow: tuple[object, ...], tmp_path: Path, code: str, says: str
) -> None:
    answer = invoke(*meadow, "--crs", code)
    assert answer.exit_code == 2
    assert says in error_line(answer.stderr)
    assert not (tmp_path / "poses.txt").exists()


def test_localize_writes_them(meadow: tuple[object, ...], tmp_path: Path) -> None:
    also = [word for end in ("tlog", "mcap") for word in ("--also", tmp_path / f"p.{end}")]
    for _ in range(2):  # files of ours are replaced
        answer = invoke(*meadow, *also, "--crs", "EPSG:32632")
        assert answer.exit_code == 0, answer.output
    rows = list(csv.DictReader((tmp_path / "poses.csv").open(newline="")))
    assert float(rows[0]["x"]) == pytest.approx(423_966, abs=2), "8° east, near Zurich"
    assert rows[1]["x"] == rows[1]["crs"] == ""
    (tmp_path / "p.mcap").write_text("mine")
    assert "p.mcap" in error_line(invoke(*meadow, *also).stderr)
    (tmp_path / "meadow" / "origin.json").unlink()
    answer = invoke(*meadow, "--crs", "EPSG:32632")
    assert "no position on earth" in error_line(answer.stderr)
