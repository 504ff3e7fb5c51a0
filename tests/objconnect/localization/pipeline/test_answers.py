"""What localize writes for people's other tools: tables, GeoJSON and KML."""

from __future__ import annotations

import csv
import json
import math
from datetime import datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import objconnect.methods
from objconnect.ingestion.attitude import gimbal_angles, gimbal_pose
from objconnect.localization.pipeline.answers import (
    Geography,
    ImageEstimate,
    encode_files,
    output_files,
)
from objconnect.scene.bundle.georeference import EXACT_GEOREFERENCE as EXACT
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, PoseSource, Status
from objconnect.scene.storage.outputs import check_outputs
from tests.benchmark.made_data import QUERY_NAMES, FakeLocalizer, pose_at, write_flight
from tests.benchmark.test_cli import error_line, invoke

KML = "{http://www.opengis.net/kml/2.2}"
PLACE = Geodetic(47.1, 8.2, 500.0)
ANGLES = st.floats(-179, 179), st.floats(-89.9, 89.9), st.floats(-179, 179)


def looking(yaw: float, pitch: float, roll: float, covariance: bool = True) -> Estimate:
    """The estimate of a camera at (10, 20, 30)."""
    rotation = gimbal_pose(yaw, pitch, roll).rotation
    centre = torch.tensor([10.0, 20.0, 30.0], dtype=torch.float64)
    spread = np.random.default_rng(1).normal(size=(6, 6)) * 1e-2
    known = spread @ spread.T if covariance else None
    pose = Pose(rotation, -rotation @ centre)
    return Estimate(Status.OK, pose, known, inliers=40, by=PoseSource.ALIGNMENT)


def write(located: list[ImageEstimate], out: Path, undulation: float | None = None) -> None:
    files = output_files(out / "poses.txt", [out / "poses.geojson", out / "poses.kml"])
    for path, content in encode_files(located, files, Geography(undulation, None, EXACT)):
        path.write_bytes(content)
    check_outputs(files)  # all of them are recognized as files of ours


@given(*ANGLES)
def test_angles_are_those_of_the_gimbal(yaw: float, pitch: float, roll: float) -> None:
    angles = gimbal_angles(gimbal_pose(yaw, pitch, roll))
    np.testing.assert_allclose(angles, [yaw, pitch, roll], atol=1e-6)


@pytest.mark.parametrize("yaw", [-170.0, 0.0, 35.0])
def test_straight_down_has_the_yaw_of_the_picture_s_top(yaw: float) -> None:
    np.testing.assert_allclose(gimbal_angles(gimbal_pose(yaw, -90, 0)), [yaw, -90, 0], atol=1e-9)


def test_the_covariance_is_that_of_centres_and_attitudes() -> None:
    """Beside poses drawn from the estimate's own covariance."""
    estimate = looking(30, -60, 4)
    pose, covariance = estimate.cam_from_world, estimate.covariance
    assert pose is not None and covariance is not None
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(6), covariance, 20_000)
    moved = Pose.exp(torch.from_numpy(drawn)) @ pose
    centres = moved.centre().numpy()
    said = estimate.world_covariance()
    assert said is not None
    np.testing.assert_allclose(np.cov(centres.T), said[:3, :3], rtol=0.1, atol=2e-5)
    # A turn about an axis of the world moves what stands still in the camera.
    turned = np.einsum("nij,jk->nik", np.swapaxes(moved.rotation.numpy(), 1, 2), pose.rotation)
    about = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], 1)
    np.testing.assert_allclose(np.cov(about.T), said[3:, 3:], rtol=0.1, atol=2e-5)
    both = np.cov(np.concatenate([centres, about], 1).T)
    np.testing.assert_allclose(both[:3, 3:], said[:3, 3:], atol=4e-5)


def test_every_format_says_the_same(tmp_path: Path) -> None:
    time = datetime(2026, 1, 2, 3, 4, 5, 678_000)
    located = [
        ImageEstimate("a b.jpg", looking(30, -60, 4), PLACE, time),
        ImageEstimate("<c>.jpg", looking(0, -90, 0), PLACE._replace(longitude=8.3)),
        ImageEstimate("d.jpg", Estimate(Status.FAILED, reason="too dark"), None),
    ]
    write(located, tmp_path, 48.5)
    rows = list(csv.DictReader((tmp_path / "poses.csv").open(newline="")))
    assert [row["name"] for row in rows] == ["a b.jpg", "<c>.jpg", "d.jpg"]
    assert rows[0]["time"] == "2026-01-02T03:04:05.678"
    assert (rows[0]["yaw_deg"], rows[0]["pitch_deg"]) == ("30.0", "-60.0")
    # Heights above the ellipsoid and above sea level differ by the undulation.
    assert float(rows[0]["altitude"]) - float(rows[0]["sea_level_m"]) == pytest.approx(48.5)
    numbers = np.array(rows[0]["covariance"].split(), float).reshape(6, 6)
    assert float(rows[0]["eph_m"]) == pytest.approx(math.sqrt(numbers[0, 0] + numbers[1, 1]), 1e-2)
    assert float(rows[0]["epv_m"]) == pytest.approx(math.sqrt(numbers[2, 2]), 1e-2)
    assert [row["by"] for row in rows] == ["alignment", "alignment", ""]
    assert rows[2]["yaw_deg"] == rows[2]["eph_m"] == ""

    features = json.loads((tmp_path / "poses.geojson").read_text())["features"]
    assert features[0]["geometry"] == {"type": "Point", "coordinates": [8.2, 47.1, 500.0]}
    assert features[0]["properties"]["yaw_deg"] == 30
    assert features[0]["properties"]["by"] == "alignment"
    assert features[1]["properties"]["name"] == "<c>.jpg"
    assert features[2]["geometry"] is None
    assert features[2]["properties"]["reason"] == "too dark"

    marks = ElementTree.parse(tmp_path / "poses.kml").getroot().iter(f"{KML}Placemark")
    names, places, modes = zip(
        *(
            [next(mark.iter(KML + tag)).text for tag in ("name", "coordinates", "altitudeMode")]
            for mark in marks
        ),
        strict=True,
    )
    assert names == ("a b.jpg", "<c>.jpg", "path")
    assert places[0] == "8.20000000,47.10000000,451.500"
    assert places[2] == f"{places[0]} {places[1]}"
    assert set(modes) == {"absolute"}


def test_without_the_geoid_marks_lie_on_the_ground(tmp_path: Path) -> None:
    write([ImageEstimate("a.jpg", looking(0, -90, 0, covariance=False), PLACE)], tmp_path)
    assert "<altitudeMode>clampToGround<" in (tmp_path / "poses.kml").read_text()
    (row,) = csv.DictReader((tmp_path / "poses.csv").open(newline=""))
    assert row["sea_level_m"] == row["covariance"] == row["eph_m"] == row["time"] == ""


def test_other_endings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"poses.gpx must end in .geojson or .kml or .tlog or .mcap"
    ):
        output_files(tmp_path / "poses.txt", [tmp_path / "poses.gpx"])


@pytest.fixture
def meadow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[object, ...]:
    """Words of a command whose method finds one photograph."""
    localizer = FakeLocalizer({"b.jpg": Estimate(Status.OK, pose_at(1), inliers=50)})
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: localizer)
    flight = write_flight(tmp_path / "meadow")
    new = tmp_path / "new"
    new.mkdir()
    for name in QUERY_NAMES:
        (new / name).write_bytes((flight / "images" / name).read_bytes())
    return ("localize", "--map", flight, "--images", new, "--out", tmp_path / "poses.txt")


def test_localize_writes_them(meadow: tuple[object, ...], tmp_path: Path) -> None:
    origin = Geodetic(47.0, 8.0, 450.0)
    (tmp_path / "meadow" / "origin.json").write_text('{"lat": 47.0, "lon": 8.0, "alt": 450.0}')
    also = ("--also", tmp_path / "map.geojson", "--also", tmp_path / "map.kml")
    for _ in range(2):  # files of ours are replaced
        answer = invoke(*meadow, *also, "--undulation", 48)
        assert answer.exit_code == 0, answer.output
    features = json.loads((tmp_path / "map.geojson").read_text())["features"]
    longitude, latitude, altitude = features[0]["geometry"]["coordinates"]
    there = enu_from_geodetic(Geodetic(latitude, longitude, altitude), origin)
    np.testing.assert_allclose(there, pose_at(1).centre(), atol=1e-3)
    assert (tmp_path / "map.kml").exists()
    (tmp_path / "map.kml").write_text("mine")
    assert "map.kml" in error_line(invoke(*meadow, *also).stderr)


def test_a_map_without_a_place_on_earth(meadow: tuple[object, ...], tmp_path: Path) -> None:
    (tmp_path / "meadow" / "origin.json").unlink(missing_ok=True)
    answer = invoke(*meadow, "--also", tmp_path / "map.kml")
    assert answer.exit_code == 2
    assert "no position on earth" in error_line(answer.stderr)
    assert not (tmp_path / "poses.txt").exists()
