"""New photographs against a map: poses, places, and what is said when it does not work."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

import objconnect.methods
from benchmark.cli import app
from objconnect.localization.pipeline.localize import Answer
from objconnect.scene.flights.textfiles import read_poses
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic, geodetic_from_enu
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, PoseSource, Query, Status
from objconnect.scene.storage.exif import Exif, write_jpeg
from tests.benchmark.made_data import CAMERA, QUERY_NAMES, FakeLocalizer, pose_at

ORIGIN = Geodetic(47.0, 8.0, 450.0)


class Remembering(FakeLocalizer):
    """Answers as told and keeps what it was asked."""

    def localize(self, query: Query) -> Estimate:
        self.asked = [*getattr(self, "asked", []), query]
        return super().localize(query)


@pytest.fixture
def method(monkeypatch: pytest.MonkeyPatch) -> Remembering:
    covariance = np.diag([1e-6] * 3 + [0.04, 0.09, 0.36])
    localizer = Remembering(
        {
            "b.jpg": Estimate(
                Status.OK,
                pose_at(1),
                covariance,
                inliers=50,
                by=PoseSource.MATCHES,
                probability=0.98765,
            ),
            "d.jpg": Estimate(
                Status.FALLBACK, pose_at(3), reason="only the prior", by=PoseSource.PRIOR
            ),
            "f.jpg": Estimate(Status.FAILED, reason="3 matches, 4 are needed"),
        }
    )
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: localizer)
    return localizer


@pytest.fixture
def photographs(made_flight: Path, tmp_path: Path) -> Path:
    (made_flight / "origin.json").write_text('{"lat": 47.0, "lon": 8.0, "alt": 450.0}')
    folder = tmp_path / "new"
    folder.mkdir()
    for name in QUERY_NAMES:
        shutil.copy(made_flight / "images" / name, folder)
    return folder


def run(place: Path, photographs: Path, out: Path, *more: str) -> Result:
    words = ["--map", place, "--images", photographs, "--out", out, *more]
    return CliRunner().invoke(app, ["localize", *map(str, words)])


def test_poses_and_places(
    made_flight: Path, photographs: Path, tmp_path: Path, method: Remembering
) -> None:
    out = tmp_path / "poses.txt"
    answer = run(made_flight, photographs, out)
    assert answer.exit_code == 0, answer.stderr
    assert answer.stdout == f"{out}: 1 of 3 photographs found\n"
    poses = read_poses(out)
    assert list(poses) == ["b.jpg"], "a fallback is not a pose found"
    metres, degrees = poses["b.jpg"].error_to(pose_at(1))
    assert float(metres) < 1e-6
    assert float(degrees) < 1e-4
    with (tmp_path / "poses.csv").open() as stream:
        rows = {row["name"]: row for row in csv.DictReader(stream)}
    assert [rows[n]["status"] for n in QUERY_NAMES] == ["ok", "fallback", "failed"]
    assert [rows[n]["by"] for n in QUERY_NAMES] == ["matches", "prior", ""]
    assert float(rows["b.jpg"]["sigma_m"]) == pytest.approx(0.7)
    assert [rows[n]["probability"] for n in QUERY_NAMES] == ["0.98765", "", ""]
    missing = "GPSLatitude is missing; DateTimeOriginal is missing"
    assert rows["f.jpg"]["reason"] == f"3 matches, 4 are needed; {missing}"
    place = Geodetic(*(float(rows["b.jpg"][k]) for k in ("latitude", "longitude", "altitude")))
    centre = enu_from_geodetic(place, ORIGIN)
    assert np.abs(centre - pose_at(1).centre().numpy()).max() < 0.01
    assert {query.camera for query in method.asked} == {CAMERA}


def test_exif_is_the_prior(
    made_flight: Path, photographs: Path, tmp_path: Path, method: Remembering
) -> None:
    place = geodetic_from_enu(np.array([5.0, -3.0, 40.0]), ORIGIN)
    pixels = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    write_jpeg(photographs / "b.jpg", pixels, Exif(place, None))
    assert run(made_flight, photographs, tmp_path / "p.txt", "--gps-sigma", "3").exit_code == 0
    asked = {query.name: query.prior for query in method.asked}
    assert asked["d.jpg"] is None
    prior = asked["b.jpg"]
    assert prior is not None
    assert np.abs(prior.position - [5, -3, 40]).max() < 0.02
    assert prior.position_sigma is not None
    assert prior.position_sigma.tolist() == [3, 3, 3]


@pytest.mark.thorough
def test_real_photographs_of_another_size(flight_copy: Path, tmp_path: Path, beach: Path) -> None:
    """As the pilot hands them over: larger than the map's, with GPS in their EXIF."""
    folder = tmp_path / "new"
    folder.mkdir()
    shutil.copy(beach / "photos" / "DJI_0019.jpg", folder)
    out = tmp_path / "poses.txt"
    answer = run(flight_copy, folder, out, "--method", "sift")
    assert answer.exit_code == 0, answer.stderr
    truth: Pose = read_poses(beach / "reference_poses.txt")["DJI_0019.jpg"]
    metres, degrees = read_poses(out)["DJI_0019.jpg"].error_to(truth)
    assert float(metres) < 0.25
    assert float(degrees) < 0.5
    with out.with_suffix(".csv").open() as stream:
        (row,) = csv.DictReader(stream)
    # The map's cameras are 1024 pixels wide, the photograph 1600.
    assert row["camera"] == "scaled"
    assert float(row["focal_px"]) == pytest.approx(597 * 1600 / 1024, abs=0.01)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--camera", "PINHOLE 96"], "expected 'MODEL width height params...'"),
        (["--camera", "SIMPLE_PINHOLE 10 10 9 5 5"], "but its camera is 10 x 10"),
        (["--priors", "nowhere.csv"], "cannot read priors nowhere.csv"),
    ],
)
def test_faults_are_one_line(
    made_flight: Path,
    photographs: Path,
    tmp_path: Path,
    method: Remembering,
    words: list[str],
    message: str,
) -> None:
    answer = run(made_flight, photographs, tmp_path / "poses.txt", *words)
    assert answer.exit_code == 2
    assert message in answer.stderr
    assert len(answer.stderr.splitlines()) == 1
    assert not (tmp_path / "poses.txt").exists()


def test_nothing_to_localize_or_nowhere(
    made_flight: Path, photographs: Path, tmp_path: Path, method: Remembering
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "holds no photograph" in run(made_flight, empty, tmp_path / "p.txt").stderr
    assert "does not exist" in run(made_flight, tmp_path / "none", tmp_path / "p.txt").stderr
    assert "is not a map" in run(empty, photographs, tmp_path / "p.txt").stderr
    (made_flight / "origin.json").write_text('{"lat": "north"}')
    answer = run(made_flight, photographs, tmp_path / "p.txt")
    assert "must hold numbers lat, lon (degrees) and alt" in answer.stderr


def test_pictures_that_are_not_read_are_counted(
    made_flight: Path,
    photographs: Path,
    tmp_path: Path,
    method: Remembering,
    caplog: pytest.LogCaptureFixture,
) -> None:
    def count_warnings() -> int:
        caplog.clear()
        answer = run(made_flight, photographs, tmp_path / "p.txt")
        assert answer.exit_code == 0 and "of 3 photographs" in answer.stdout, answer.stderr
        return sum("not read" in record.getMessage() for record in caplog.records)

    (photographs / "notes.txt").touch()
    (photographs / "empty").mkdir()
    assert count_warnings() == 0
    for name in ("one/a.jpg", "one/b.JPG", "two/deep/c.png", ".hidden/d.jpg"):
        (photographs / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(photographs / "b.jpg", photographs / name)
    for name in ("a.TIF", "b.webp", "c.tif", "one/d.tif"):
        (photographs / name).touch()
    assert count_warnings() == 1
    assert (
        "not read: 3 photographs in sub-folders (one, two/deep) and 3 pictures of other kinds "
        "(.tif, .webp)"
    ) in caplog.text


def test_the_error_of_an_empty_folder_names_its_sub_folders(
    made_flight: Path, photographs: Path, tmp_path: Path, method: Remembering
) -> None:
    card = tmp_path / "card"
    for name in ("100MEDIA", "101MEDIA", "102MEDIA", "103MEDIA", "104MEDIA"):
        shutil.copytree(photographs, card / name)
    answer = run(made_flight, card, tmp_path / "p.txt")
    assert answer.exit_code == 2
    assert (
        "(.jpg, .jpeg, .png); not read: 15 photographs in sub-folders (100MEDIA, 101MEDIA, "
        "102MEDIA, 2 more)"
    ) in answer.stderr


def test_the_risk_is_that_of_the_search(
    made_flight: Path, photographs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[dict[str, Any]] = []
    predicting = SimpleNamespace(search=SimpleNamespace(risk=0.05))
    silent = SimpleNamespace(search=SimpleNamespace())

    def create(name: str, overrides: dict[str, Any]) -> Remembering:
        given.append(overrides)
        localizer = Remembering({})
        if name != "sift":
            config = silent if name == "place" else predicting
            monkeypatch.setattr(localizer, "config", config)
        return localizer

    monkeypatch.setattr(objconnect.methods, "create", create)
    out = tmp_path / "poses.txt"
    for words, message in (
        (["--method", "sift"], "sift predicts no probability of its poses: leave out --risk"),
        (["--method", "place"], "place predicts no probability of its poses: leave out --risk"),
        (["--set", "search.risk=0.1"], "--risk and --set search.risk are the same"),
        (["--set", "search={risk: 0.1}"], "--risk and --set search.risk are the same"),
    ):
        answer = run(made_flight, photographs, out, "--risk", "0.02", *words)
        assert answer.exit_code == 2 and message in answer.stderr
        assert len(answer.stderr.splitlines()) == 1
    run(made_flight, photographs, out, "--risk", "0.02")
    assert given[-1] == {"search.risk": 0.02}


@pytest.mark.parametrize("probability", [0.98765, None])
def test_the_journal_keeps_the_probability(probability: float | None) -> None:
    estimate = Estimate(
        Status.OK, pose_at(1), np.eye(6), by=PoseSource.MATCHES, probability=probability
    )
    line = Answer.of("b.jpg", "asked", estimate).model_dump_json()
    assert Answer.model_validate_json(line).estimate().probability == probability
