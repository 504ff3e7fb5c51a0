"""What photographs and videos do not say for sure stands in the rows of the answer."""

from __future__ import annotations

import csv
import json
import logging
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner, Result

import objconnect.methods
from benchmark.cli import app
from objconnect.scene.geo import sea_level
from objconnect.scene.localizer import Estimate, Status
from objconnect.scene.storage.images import read_rgb
from tests.benchmark.made_data import QUERY_NAMES, FakeLocalizer, pose_at
from tests.objconnect.scene.quantities import raw_exif as raw

PLACE = {
    "GPSLatitude": raw.rational(47.0001),
    "GPSLatitudeRef": raw.text("N"),
    "GPSLongitude": raw.rational(8.0001),
    "GPSLongitudeRef": raw.text("E"),
}
# 24 mm on film, and 131 mm by the resolution of the picture before it was resized.
CONTRADICTION = {
    "FocalLength": raw.rational(8.8),
    "FocalPlaneXResolution": raw.rational(400.0),
    "FocalPlaneResolutionUnit": raw.short(3),
    "ExifImageWidth": raw.long(96),
    "ExifImageHeight": raw.long(64),
    "FocalLengthIn35mmFilm": raw.short(24),
}
FIELDS = ("FocalPlaneXResolution", "FocalLengthIn35mmFilm")


TIME = {"DateTimeOriginal": raw.text("2026:06:01 12:00:00")}


def run(*words: object) -> Result:
    return CliRunner().invoke(app, ["localize", *map(str, words)])


def rows_of(path: Path) -> dict[str, dict[str, str]]:
    with path.open() as stream:
        return {row["name"]: row for row in csv.DictReader(stream)}


@pytest.fixture
def place(made_flight: Path) -> Path:
    (made_flight / "origin.json").write_text('{"lat": 47.0, "lon": 8.0, "alt": 450.0}')
    return made_flight


@pytest.fixture
def method(monkeypatch: pytest.MonkeyPatch) -> FakeLocalizer:
    answers = {
        "b.jpg": Estimate(Status.OK, pose_at(1), inliers=50, reason="half of it is water"),
        "d.jpg": Estimate(Status.OK, pose_at(3), inliers=50),
    }
    localizer = FakeLocalizer(answers)
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: localizer)
    return localizer


def photographs(
    place: Path, folder: Path, detail: dict[str, raw.Field], gps: dict[str, raw.Field]
) -> Path:
    """The queries of a flight with fields of our own, and a time if these have none."""
    folder.mkdir()
    detail = TIME | detail
    for name in QUERY_NAMES:
        height, width = read_rgb(place / "images" / name).shape[:2]
        raw.write(folder / name, (width, height), raw.exif(detail, gps))
    return folder


def test_a_doubt_follows_the_reason(place: Path, method: FakeLocalizer, tmp_path: Path) -> None:
    folder = photographs(place, tmp_path / "new", {}, PLACE)
    out = tmp_path / "t.txt"
    answer = run("--map", place, "--images", folder, "--out", out, "--also", tmp_path / "t.geojson")
    assert answer.exit_code == 0, answer.stderr
    rows = rows_of(out.with_suffix(".csv"))
    assert rows["b.jpg"]["reason"] == "half of it is water; GPSAltitude is missing"
    assert rows["d.jpg"]["status"] == "ok" and rows["d.jpg"]["reason"] == "GPSAltitude is missing"
    assert rows["f.jpg"]["reason"] == "nothing found; GPSAltitude is missing"
    features = json.loads((tmp_path / "t.geojson").read_text())["features"]
    said = {one["properties"]["name"]: one["properties"].get("reason") for one in features}
    assert said == {name: row["reason"] for name, row in rows.items()}


def test_what_is_given_is_not_doubted(
    place: Path, method: FakeLocalizer, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    folder = photographs(place, tmp_path / "new", CONTRADICTION, PLACE)
    table = tmp_path / "priors.csv"
    table.write_text("name,lat,lon,alt\n" + "".join(f"{n},47,8,500\n" for n in QUERY_NAMES))
    camera = "SIMPLE_RADIAL 96 64 80 48 32 0.01"
    words = ("--map", place, "--images", folder, "--out", tmp_path / "t.txt")
    answer = run(*words, "--priors", table, "--camera", camera)
    assert answer.exit_code == 0, answer.stderr
    assert rows_of(tmp_path / "t.csv")["d.jpg"]["reason"] == ""
    assert "GPSAltitude" not in caplog.text and "FocalPlane" not in caplog.text


def test_a_prior_tells_no_focal_length(place: Path, tmp_path: Path) -> None:
    gps = PLACE | {"GPSAltitude": raw.rational(500.0), "GPSAltitudeRef": raw.byte(0)}
    folder = photographs(place, tmp_path / "new", CONTRADICTION, gps)
    words = ("--map", place, "--images", folder, "--out", tmp_path / "t.txt", "--method", "prior")
    answer = run(*words)
    assert answer.exit_code == 0, answer.stderr
    for row in rows_of(tmp_path / "t.csv").values():
        assert row["status"] == "ok" and row["camera"] == "estimated"
        assert row["focal_px"] == ""
        assert all(field in row["reason"] for field in FIELDS)


def test_a_sequence_names_the_fields(place: Path, method: FakeLocalizer, tmp_path: Path) -> None:
    folder = photographs(place, tmp_path / "new", CONTRADICTION, PLACE)
    words = ("--map", place, "--images", folder, "--out", tmp_path / "t.txt", "--sequence")
    refused = run(*words, "--rate", 1)
    assert refused.exit_code == 2
    assert all(field in refused.stderr for field in (*FIELDS, "give --camera"))
    # One that is read makes the others rows.
    shutil.copy(place / "images" / "b.jpg", folder)
    answer = run(*words, "--rate", 1)
    assert answer.exit_code == 0, answer.stderr
    row = rows_of(tmp_path / "t.csv")["d.jpg"]
    assert all(row["reason"].count(field) == 1 for field in FIELDS)


def test_an_altitude_above_the_sea_takes_the_undulation(
    place: Path, method: FakeLocalizer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sea_level, "geoid_undulation", lambda place: None)
    gps = PLACE | {"GPSAltitude": raw.rational(460.0), "GPSAltitudeRef": raw.byte(2)}
    folder = photographs(place, tmp_path / "new", {}, gps)
    for more, up, said in (((), 10.0, True), (("--undulation", 47.5), 57.5, False)):
        method.seen.clear()
        out = tmp_path / f"{said}.txt"
        answer = run("--map", place, "--images", folder, "--out", out, *more)
        assert answer.exit_code == 0, answer.stderr
        prior = method.seen[-1].prior
        assert prior is not None and prior.position[2] == pytest.approx(up, abs=0.01)
        row = rows_of(out.with_suffix(".csv"))["b.jpg"]
        assert ("sea level" in row["reason"]) is said


def test_a_position_far_from_the_map_is_said(
    place: Path, method: FakeLocalizer, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    gps = PLACE | {"GPSAltitude": raw.rational(500.0), "GPSAltitudeRef": raw.byte(0)}
    folder = photographs(place, tmp_path / "new", {}, gps | {"GPSLongitude": raw.rational(9.00005)})
    answer = run("--map", place, "--images", folder, "--out", tmp_path / "t.txt")
    assert answer.exit_code == 0, answer.stderr
    row = rows_of(tmp_path / "t.csv")["d.jpg"]
    assert row["reason"] == "its position is 76 km from the map and is not used"
    assert "76 km from the map" in caplog.text
    assert method.seen[-1].prior is None


@pytest.mark.parametrize(
    ("metres", "below", "said"),
    [
        (500.0, 0, ""),
        (10_000.0, 0, ""),
        (100_000.0, 0, "m above the map's ground and is not used"),
        (301.0, 0, ""),  # the ground is at 449 to 451 m
        (297.0, 0, "its altitude is 152 m below the map's ground and is not used"),
        (500.0, 1, "m below the map's ground and is not used"),
    ],
)
def test_an_altitude_that_cannot_be_true_is_unknown(
    place: Path, method: FakeLocalizer, tmp_path: Path, metres: float, below: int, said: str
) -> None:
    gps = PLACE | {"GPSAltitude": raw.rational(metres), "GPSAltitudeRef": raw.byte(below)}
    folder = photographs(place, tmp_path / "new", {}, gps)
    answer = run("--map", place, "--images", folder, "--out", tmp_path / "t.txt")
    assert answer.exit_code == 0, answer.stderr
    prior = method.seen[-1].prior
    assert prior is not None and prior.position_sigma is not None
    reason = rows_of(tmp_path / "t.csv")["d.jpg"]["reason"]
    if said:
        assert said in reason
        assert prior.position[2] == pytest.approx(40) and np.isinf(prior.position_sigma[2])
    else:
        assert reason == ""
        assert prior.position[2] == pytest.approx(metres - 450, abs=0.1)
        assert prior.position_sigma[2] == 10


@pytest.mark.parametrize(
    ("time", "said"),
    [
        ("0000:00:00 00:00:00", "DateTimeOriginal '0000:00:00 00:00:00' is not a time"),
        ("", "DateTimeOriginal is missing"),
        ("2026-06-01T12:00:00Z", ""),
    ],
)
def test_a_time_that_cannot_be_read_is_named(
    place: Path,
    method: FakeLocalizer,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    time: str,
    said: str,
) -> None:
    caplog.set_level(logging.WARNING)
    gps = PLACE | {"GPSAltitude": raw.rational(500.0), "GPSAltitudeRef": raw.byte(0)}
    folder = photographs(place, tmp_path / "new", {"DateTimeOriginal": raw.text(time)}, gps)
    answer = run("--map", place, "--images", folder, "--out", tmp_path / "t.txt")
    assert answer.exit_code == 0, answer.stderr
    row = rows_of(tmp_path / "t.csv")["d.jpg"]
    assert row["reason"] == said and bool(row["time"]) == (not said)
    assert said in caplog.text and ("DateTimeOriginal" in caplog.text) == bool(said)


def test_without_exif_the_reason_says_what_is_missing(
    place: Path, method: FakeLocalizer, tmp_path: Path
) -> None:
    folder = tmp_path / "new"
    folder.mkdir()
    Image.new("RGB", (90, 40)).save(folder / "d.jpg")  # of no camera of the map
    words = ("--map", place, "--images", folder, "--out", tmp_path / "t.txt")
    assert run(*words).exit_code == 0
    missing = "GPSLatitude is missing; DateTimeOriginal is missing"
    assert rows_of(tmp_path / "t.csv")["d.jpg"]["reason"] == f"{missing}; EXIF has no focal length"
    refused = run(*words, "--sequence", "--rate", 1)
    assert refused.exit_code == 2 and "d.jpg is unknown: give --camera" in refused.stderr
