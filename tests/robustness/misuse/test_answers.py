"""What commands read of names, tables and numbers, and what their answers may replace."""

from __future__ import annotations

import csv
import json
import os
import shutil
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import objconnect.methods
from benchmark.report.leaderboard import leaderboard
from benchmark.report.markdown import escape
from benchmark.results.results_files import load
from objconnect.ingestion.photographs import read_flight
from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.loop import _claim as claim_run
from objconnect.localization.matching.structure import StructureConfig
from objconnect.localization.pipeline.localization_map import open_map
from objconnect.scene.errors import InputError
from objconnect.scene.exports.export import export
from objconnect.scene.flights.textfiles import (
    pose_line,
    read_cameras,
    read_gps,
    read_pairs,
    read_poses,
)
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from objconnect.scene.geometry.nearest import NearestNeighbours
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, PoseSource, Prior, Query, Status
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.exif import Exif, write_jpeg
from objconnect.scene.storage.names import (
    quote_cell,
    quote_name,
    split_name,
    split_words,
    unquote_cell,
)
from tests.benchmark.made_data import (
    CAMERA,
    QUERY_NAMES,
    FakeLocalizer,
    pose_at,
    write_flight,
    write_scene,
)
from tests.benchmark.test_cli import error_line, invoke

ORIGIN = Geodetic(47.0, 8.0, 450.0)
# What a file system allows, and a line of text does not.
FORGED = "n\nb.jpg 1 0 0 0 0 0 0.jpg"
ODD = ("a b.jpg", FORGED, "#h.jpg", '"q".jpg', "t\tt.jpg", "=1+1.jpg", os.fsdecode(b"\xff.jpg"))


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    """A small flight, whose origin is known."""
    path = write_flight(tmp_path / "meadow")
    (path / "origin.json").write_text('{"lat": 47.0, "lon": 8.0, "alt": 450.0}')
    return path


@pytest.fixture
def photographs(flight: Path, tmp_path: Path) -> Path:
    """Three new photographs."""
    folder = tmp_path / "new"
    folder.mkdir()
    for name in QUERY_NAMES:
        shutil.copy(flight / "images" / name, folder)
    return folder


@pytest.fixture
def method(monkeypatch: pytest.MonkeyPatch) -> FakeLocalizer:
    """Finds every photograph that it is told to."""
    localizer = FakeLocalizer({"b.jpg": Estimate(Status.OK, pose_at(1), inliers=50)})
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: localizer)
    return localizer


def tree(folder: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    return {
        os.fsdecode(os.fsencode(path.relative_to(folder))): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def expect_error(folder: Path, *command: object) -> str:
    """The one line of a command that must fail and change nothing."""
    before = tree(folder)
    answer = invoke(*command)
    assert answer.exit_code == 2, answer.output
    assert tree(folder) == before
    return error_line(answer.stderr)


def localizing(flight: Path, photographs: Path, out: Path, *more: object) -> tuple[object, ...]:
    return ("localize", "--map", flight, "--images", photographs, "--out", out, *more)


def rows(table: Path) -> dict[str, dict[str, str]]:
    with table.open(newline="", encoding="utf-8") as stream:
        return {unquote_cell(row["name"]): row for row in csv.DictReader(stream)}


# ---- localize: what its outputs may replace


PRIORS = "name,e,n,u,sigma_m,qw,qx,qy,qz,sigma_deg\nb.jpg,0,0,40,1,0,1,0,0,2\n"


def test_priors_are_not_replaced_by_the_table(
    flight: Path, photographs: Path, tmp_path: Path, method: FakeLocalizer
) -> None:
    priors = tmp_path / "a.csv"
    priors.write_text(PRIORS)
    line = expect_error(
        tmp_path, *localizing(flight, photographs, tmp_path / "a.txt", "--priors", priors)
    )
    assert "a.csv is read by this command" in line
    assert not method.seen


def test_the_table_does_not_replace_the_poses(
    flight: Path, photographs: Path, tmp_path: Path, method: FakeLocalizer
) -> None:
    for name in ("poses.csv", "poses.CSV"):
        line = expect_error(tmp_path, *localizing(flight, photographs, tmp_path / name))
        assert "a name that ends in .txt" in line


@pytest.mark.parametrize("name", ["poses.txt", "poses.csv"])
def test_a_file_of_the_user_stays_and_one_of_ours_is_replaced(
    flight: Path, photographs: Path, tmp_path: Path, method: FakeLocalizer, name: str
) -> None:
    theirs = tmp_path / name
    theirs.write_text("name,mine\n")
    command = localizing(flight, photographs, tmp_path / "poses.txt")
    assert "it is a file of another program" in expect_error(tmp_path, *command)
    assert not method.seen, "before any work"
    theirs.unlink()
    for _ in range(2):
        assert invoke(*command).exit_code == 0
    assert "b.jpg,ok" in (tmp_path / "poses.csv").read_text()


@pytest.mark.parametrize("more", [(), ("--sequence", "--rate", 1)])
def test_answers_lie_outside_of_the_photographs(
    flight: Path, photographs: Path, tmp_path: Path, method: FakeLocalizer, more: tuple[object, ...]
) -> None:
    said = "lies in the folder of photographs: choose one outside it"
    for out in (photographs / "poses.txt", photographs / "out" / "poses.txt"):
        line = expect_error(tmp_path, *localizing(flight, photographs, out, *more))
        assert line == f"objconnect: error: {out} {said}"
    also = photographs / "poses.geojson"
    command = localizing(flight, photographs, tmp_path / "poses.txt", "--also", also, *more)
    assert expect_error(tmp_path, *command) == f"objconnect: error: {also} {said}"
    assert not method.seen


def test_an_output_that_cannot_be_written_is_told_before_work(
    flight: Path, photographs: Path, tmp_path: Path, method: FakeLocalizer
) -> None:
    (tmp_path / "file").write_text("")
    line = expect_error(tmp_path, *localizing(flight, photographs, tmp_path / "file" / "poses.txt"))
    assert "cannot write" in line
    assert not method.seen


# ---- localize: a photograph that cannot be asked is a row


def test_a_bad_photograph_is_a_row(
    flight: Path, photographs: Path, tmp_path: Path, method: FakeLocalizer
) -> None:
    (photographs / "e.jpg").write_bytes((photographs / "d.jpg").read_bytes()[:300])
    Image.new("RGB", (31, 17)).save(photographs / "f.jpg")
    out = tmp_path / "poses.txt"
    answer = invoke(*localizing(flight, photographs, out))
    assert answer.exit_code == 0, answer.stderr
    assert list(read_poses(out)) == ["b.jpg"]
    table = rows(out.with_suffix(".csv"))
    assert [table[name]["status"] for name in sorted(table)] == ["ok", "failed", "failed", "failed"]
    assert "damaged" in table["e.jpg"]["reason"]
    missing = "GPSLatitude is missing; DateTimeOriginal is missing; EXIF has no focal length"
    assert table["f.jpg"]["reason"] == f"nothing found; {missing}"
    assert table["f.jpg"]["camera"] == "estimated"


def test_no_good_photograph_is_a_fault(
    flight: Path, photographs: Path, tmp_path: Path, method: FakeLocalizer
) -> None:
    for name in QUERY_NAMES:
        (photographs / name).write_bytes(b"no image")
    line = expect_error(tmp_path, *localizing(flight, photographs, tmp_path / "poses.txt"))
    assert "none of the 3 photographs" in line


def test_what_was_found_outlives_an_interruption(
    flight: Path, photographs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    covariance = np.diag([1e-6] * 3 + [0.04, 0.09, 0.36])
    found = Estimate(Status.OK, pose_at(1), covariance, inliers=50, by=PoseSource.MATCHES)
    first = FakeLocalizer({"b.jpg": found, "d.jpg": found, "f.jpg": KeyboardInterrupt()})
    second = FakeLocalizer({"f.jpg": found})
    turns: Iterator[FakeLocalizer] = iter([first, second, second])
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: next(turns))
    out = tmp_path / "poses.txt"
    command = localizing(flight, photographs, out)
    assert invoke(*command).exit_code == 130
    assert not out.exists()
    # Another photograph of this name is asked again.
    shutil.copy(flight / "images" / "a.jpg", photographs / "d.jpg")
    assert invoke(*command).exit_code == 0
    assert [query.name for query in second.seen] == ["d.jpg", "f.jpg"]
    table = rows(out.with_suffix(".csv"))
    assert [table[name]["status"] for name in QUERY_NAMES] == ["ok", "failed", "ok"]
    assert table["b.jpg"]["by"] == "matches"
    assert float(table["b.jpg"]["sigma_m"]) == pytest.approx(0.7)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["meadow", "new", "poses.csv", "poses.txt"]


# ---- names


def test_poses_and_tables_hold_every_name(
    flight: Path, photographs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ODD:
        shutil.copy(photographs / "b.jpg", photographs / name)
    every = [*ODD, *QUERY_NAMES]
    localizer = FakeLocalizer({name: Estimate(Status.OK, pose_at(1)) for name in every})
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: localizer)
    out = tmp_path / "poses.txt"
    answer = invoke(*localizing(flight, photographs, out))
    assert answer.exit_code == 0, answer.stderr
    assert set(read_poses(out)) == set(every)
    assert len(out.read_text().splitlines()) == 1 + len(every)
    assert set(rows(out.with_suffix(".csv"))) == set(every)
    assert "\nb.jpg 0" in out.read_text(), "plain names stand as they are"


def test_odd_queries_are_scored(flight: Path, tmp_path: Path) -> None:
    odd = "a b\n#.jpg"
    (flight / "images" / "b.jpg").rename(flight / "images" / odd)
    for name in ("queries.txt", "reference_poses.txt"):
        text = (flight / name).read_text()
        (flight / name).write_text(text.replace("b.jpg", quote_name(odd)))
    poses = tmp_path / "found.txt"
    poses.write_text(pose_line(odd, pose_at(1), 9) + "\n")
    command = ("score", poses, "--reference", flight, "--out", tmp_path / "out")
    assert invoke(*command).exit_code == 0
    results = load(tmp_path / "out/meadow/found.json")
    assert {query.name: query.status for query in results.queries}[odd] is Status.OK


@given(st.text(st.characters(exclude_characters="/\0"), min_size=1))
def test_every_name_comes_back(name: str) -> None:
    assert split_words(f"{quote_name(name)} {quote_name(name)}") == [name, name]
    assert split_name(f"{quote_name(name)} 1 2 3", 3) == (name, ["1", "2", "3"])
    assert unquote_cell(quote_cell(name)) == name
    assert len(quote_name(name).splitlines()) == 1
    quote_name(name).encode()
    quote_cell(name).encode()


def test_names_with_spaces_of_other_programs(tmp_path: Path) -> None:
    file = tmp_path / "list.txt"
    file.write_text("my photo 2.jpg 1 0 0 0 1 2 3\n")
    assert list(read_poses(file)) == ["my photo 2.jpg"]
    file.write_text(f"my photo 2.jpg {CAMERA}\n")
    assert read_cameras(file) == {"my photo 2.jpg": CAMERA}
    file.write_text('"a b.jpg" c.jpg\n')
    assert read_pairs(file) == {"a b.jpg": ("c.jpg",)}
    for text in ("a.jpg 1 1 0 0 0 1 2 3\n", "a.jpg 1 0 0 0 1 2\n", '"a.jpg 1 0 0 0 1 2 3\n'):
        file.write_text(text)
        with pytest.raises(InputError, match=r"list\.txt:1: expected 8 columns"):
            read_poses(file)
    file.write_text("a b.jpg c.jpg\n")
    with pytest.raises(InputError, match="double quotes"):
        read_pairs(file)


def test_photographs_whose_names_are_not_utf8_are_left_out(tmp_path: Path) -> None:
    photograph = np.zeros((20, 30, 3), np.uint8)
    for name in (os.fsdecode(b"\xff.jpg"), "b.jpg"):
        write_jpeg(tmp_path / name, photograph, Exif(None, None))
    roll = read_flight(tmp_path)
    assert [shot.file for shot in roll.images] == ["b.jpg"]
    assert roll.left_out == {r"\udcff.jpg": "its name is not UTF-8: rename it"}


def test_a_data_set_whose_name_is_not_utf8(tmp_path: Path) -> None:
    flight = write_flight(tmp_path / os.fsdecode(b"m\xff"))
    out = tmp_path / "out"
    line = expect_error(tmp_path, "evaluate", flight, "--method", "prior", "--out", out)
    assert "not UTF-8" in line


def test_capitals_are_told(
    flight: Path, photographs: Path, tmp_path: Path, method: FakeLocalizer
) -> None:
    table = flight / "gps.csv"
    table.write_text(table.read_text().replace(".jpg", ".JPG"))
    out = tmp_path / "out"
    line = expect_error(tmp_path, "evaluate", flight, "--method", "prior", "--out", out)
    assert "gps.csv lists 'a.JPG', but the photograph is called 'a.jpg'" in line
    priors = tmp_path / "a.csv"
    priors.write_text(PRIORS.replace("b.jpg", "B.JPG"))
    line = expect_error(
        tmp_path, *localizing(flight, photographs, tmp_path / "p.txt", "--priors", priors)
    )
    assert "lists 'B.JPG', but the photograph is called 'b.jpg'" in line


# ---- tables


def test_tables_of_spreadsheets(tmp_path: Path) -> None:
    table = tmp_path / "gps.csv"
    table.write_bytes("\ufeffname,e,n,u,,\r\nb.jpg,1,2,3,,\r\n".encode())
    assert read_gps(table)["b.jpg"].tolist() == [1, 2, 3]
    table.write_bytes(b"name,e,n,u\rb.jpg,1,2,3\r")
    assert read_gps(table)["b.jpg"].tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,e,n,u,e\nb.jpg,1,2,3,900000\n", r"gps\.csv:1: .* has the column 'e' twice"),
        (
            'name,e,n,u\n"b.jpg,1,2,3\n' + "x,1,2,3\n" * 30_000,
            r"gps\.csv:2: .*may be unclosed",
        ),
        ('name,e,n,u\n"b.jpg,1,2,3\nd.jpg,1,2,3\n', r"gps\.csv:2: .*may be unclosed"),
        ('name,e,n,u\n"b.jpg\nd.jpg",1,2,3\n', r"gps\.csv:2: .*is not a name"),
        ("name,e,n,u\nb.jpg,1e300,2,3\n", r"gps\.csv:2: b.jpg lies more than 1e\+08 m away"),
    ],
)
def test_faults_of_tables_are_one_line(tmp_path: Path, text: str, message: str) -> None:
    table = tmp_path / "gps.csv"
    table.write_text(text)
    with pytest.raises(InputError, match=message):
        read_gps(table)


# ---- numbers


def put_far_point(flight: Path) -> None:
    points = flight / "sparse/map/points3D.bin"
    data = bytearray(points.read_bytes())
    data[16:24] = struct.pack("<d", 1e300)
    points.write_bytes(bytes(data))


def put_far_pose(flight: Path) -> None:
    poses = flight / "reference_poses.txt"
    first, *rest = poses.read_text().splitlines()[1:]
    poses.write_text("\n".join([" ".join([*first.split()[:5], "1e308", "0", "0"]), *rest]))


@pytest.mark.parametrize("put", [put_far_point, put_far_pose])
def test_what_lies_beyond_the_earth_is_refused(
    flight: Path, tmp_path: Path, put: Callable[[Path], None]
) -> None:
    put(flight)
    line = expect_error(
        tmp_path, "evaluate", flight, "--method", "prior", "--out", tmp_path / "out"
    )
    assert "more than 1e+08 m away" in line


def test_the_nearest_of_huge_places() -> None:
    nearest = NearestNeighbours(np.array([[1e300, 0.0], [0.0, 0.0], [2e300, 1e300]]))
    with np.errstate(over="ignore"):
        assert nearest(np.array([1.5e300, 0.0]), 1).tolist() == [0]


def test_a_pose_from_nowhere_is_a_failure(
    flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    away = Pose(pose_at(1).rotation, pose_at(1).translation * 1e300)
    method = FakeLocalizer({"b.jpg": Estimate(Status.OK, away)})
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: method)
    answer = invoke("evaluate", flight, "--method", "fake", "--out", tmp_path / "out")
    assert answer.exit_code == 0, answer.stderr
    (query,) = [q for q in load(tmp_path / "out/meadow/fake.json").queries if q.name == "b.jpg"]
    assert (query.status, query.reason) == (
        Status.FAILED,
        "the pose is more than 1e+08 m from the map's origin",
    )


@pytest.mark.parametrize(
    ("field", "value"),
    [("t_err_m", 1e308), ("seconds", {"total": 1e308}), ("nees", 1e308), ("altitude_m", -1e308)],
)
def test_huge_numbers_in_results(scored: Path, field: str, value: object) -> None:
    content = json.loads(scored.read_text())
    for query in content["queries"]:
        query[field] = value
    scored.write_text(json.dumps(content))
    line = expect_error(scored.parent, "leaderboard", scored)
    assert field in line


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("max_error_px=.inf", "finite"),
        ("max_error_px=1e300", "at most"),
        ("memory_mb=4294967296", "at most"),
        ("max_features=99999999999", "at most"),
        ("references=", "is not valid"),
        ("references=null", "valid integer"),
    ],
)
def test_settings_that_nothing_has(
    flight: Path, tmp_path: Path, setting: str, message: str
) -> None:
    command = ("evaluate", flight, "--method", "sift", "--out", tmp_path / "out", "--set", setting)
    line = expect_error(tmp_path, *command)
    assert message in line
    assert setting.partition("=")[0] in line


@pytest.mark.parametrize("start", ["error=3m,500deg", "error=999999999m,1deg", "pairs="])
def test_starts_that_nothing_has(flight: Path, tmp_path: Path, start: str) -> None:
    command = ("evaluate", flight, "--method", "prior", "--out", tmp_path / "out", "--start", start)
    expect_error(tmp_path, *command)


def test_a_start_of_kilometres_is_scored(flight: Path, tmp_path: Path) -> None:
    """Its name is written out: ``1e+06m`` is none that results take."""
    words = ("--method", "prior", "--start", "error=1000000m,5deg", "--out", tmp_path / "out")
    answer = invoke("evaluate", flight, *words)
    assert answer.exit_code == 0, answer.stderr
    assert load(tmp_path / "out/meadow/prior.json").start == "error=1000000m,5deg"


def test_every_configuration_is_bounded() -> None:
    with pytest.raises(ValueError, match="at most"):
        StructureConfig(memory_mb=2**32)
    assert StructureConfig(memory_mb=2**31 - 1).memory_mb == 2**31 - 1


# ---- score and evaluate


@pytest.fixture
def poses(flight: Path, tmp_path: Path) -> Path:
    """Poses that another program found."""
    path = tmp_path / "elsewhere.txt"
    path.write_text(pose_line("b.jpg", pose_at(1), 9) + "\n")
    return path


@pytest.fixture
def scored(flight: Path, poses: Path, tmp_path: Path) -> Path:
    """Results of score."""
    answer = invoke("score", poses, "--reference", flight, "--out", tmp_path / "results")
    assert answer.exit_code == 0, answer.stderr
    return tmp_path / "results/meadow/elsewhere.json"


@pytest.mark.parametrize("name", ["../../../x", "a/b", "", " ", ".hidden", "x.basin", "a\nb"])
def test_a_method_names_a_file_in_its_folder(
    flight: Path, poses: Path, tmp_path: Path, name: str
) -> None:
    words = ("--reference", flight, "--out", tmp_path / "deep/er/results", f"--method={name}")
    assert "method" in expect_error(tmp_path, "score", poses, *words)


def test_score_and_evaluate_keep_each_others_results(
    flight: Path, poses: Path, tmp_path: Path
) -> None:
    out = tmp_path / "results"
    score = ("score", poses, "--reference", flight, "--out", out, "--method", "prior")
    evaluate = ("evaluate", flight, "--method", "prior", "--out", out)
    assert invoke(*evaluate).exit_code == 0
    assert "results that evaluate wrote: choose another --method" in expect_error(out, *score)
    assert invoke(*evaluate).exit_code == 0, "results of the same command are replaced"
    (out / "meadow/prior.json").unlink()
    assert invoke(*score).exit_code == 0
    assert "results that score wrote: remove it" in expect_error(out, *evaluate)
    assert invoke(*score).exit_code == 0


@pytest.mark.parametrize("name", ["prior.json", "prior-query.png", "album.h5"])
def test_evaluate_keeps_files_of_the_user(flight: Path, tmp_path: Path, name: str) -> None:
    mine = tmp_path / "results/meadow" / name
    mine.parent.mkdir(parents=True)
    mine.write_text('{"mine": true}')
    command = ("evaluate", flight, "--method", "prior", "--out", tmp_path / "results")
    assert "it is a file of another program" in expect_error(tmp_path, *command)


# ---- what other commands may replace


@pytest.mark.parametrize("name", ["leaderboard.md", "leaderboard.tex", "leaderboard.html"])
def test_leaderboard_keeps_files_of_the_user(scored: Path, tmp_path: Path, name: str) -> None:
    out = tmp_path / "board"
    for _ in range(2):
        assert invoke("leaderboard", scored, "--out", out).exit_code == 0
    (out / name).write_text("# my notes\n")
    assert "it is a file of another program" in expect_error(
        out, "leaderboard", scored, "--out", out
    )


def test_view_keeps_files_of_the_user(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "hamlet")
    line = expect_error(tmp_path, "view", scene, "--out", scene / "scene.json")
    assert "must end in .html" in line
    photo = tmp_path / "photo.png"
    Image.new("RGB", (8, 8)).save(photo)
    line = expect_error(tmp_path, "view", scene, "--out", tmp_path / "photo.html")
    assert "photo.png: it is a file of another program" in line
    photo.unlink()
    (tmp_path / "photo.html").write_text("<title>mine</title>")
    line = expect_error(tmp_path, "view", scene, "--out", tmp_path / "photo.html")
    assert "photo.html: it is a file of another program" in line


def test_view_of_other_results_says_so(scored: Path, tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "hamlet")
    results = scored.parents[1]
    line = expect_error(tmp_path, "view", scene, "--results", results, "--out", tmp_path / "v.html")
    assert "the results are of meadow, not of the scene hamlet" in line


def test_basin_and_baseline_keep_files_of_the_user(
    flight: Path, scored: Path, tmp_path: Path
) -> None:
    results = scored.parents[1]
    baseline = tmp_path / "baseline/meadow"
    baseline.mkdir(parents=True)
    (baseline / "elsewhere.json").write_text('{"mine": true}')
    line = expect_error(tmp_path, "regress", results, "--against", baseline.parent, "--update")
    assert "it is a file of another program" in line
    assert "is read" in expect_error(tmp_path, "regress", results, "--against", results, "--update")
    (results / "meadow/prior.basin.json").write_text('{"mine": true}')
    line = expect_error(tmp_path, "basin", flight, "--method", "prior", "--out", results)
    assert "it is a file of another program" in line


@pytest.mark.parametrize(
    ("command", "name"),
    [("calibrate", "corners.png"), ("calibrate", "views/000000.png")],
)
def test_renderers_keep_files_of_the_user(tmp_path: Path, command: str, name: str) -> None:
    mine = tmp_path / "out" / name
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    assert "it is a file of another program" in expect_error(
        tmp_path, command, "--out", tmp_path / "out"
    )


@pytest.mark.parametrize("name", ["weights.safetensors", "log.jsonl", "curves.png", "scene.json"])
def test_training_keeps_files_of_the_user(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("mine")
    before = tree(tmp_path)
    with pytest.raises(InputError, match="is not empty and not a training run: choose another"):
        claim_run(tmp_path, {"config": TrainConfig().model_dump(mode="json")}, 0)
    assert tree(tmp_path) == before


def test_an_export_lies_outside_of_its_scene(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "hamlet")
    before = tree(scene)
    for out in (scene / "export", scene / "sessions/../out"):
        with pytest.raises(InputError, match="lies in the scene itself"):
            export(scene, "colmap", out)
    assert tree(scene) == before


# ---- names in answers


def test_no_condition_is_called_all(scored: Path, tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "hamlet")
    manifest = scene / "scene.json"
    manifest.write_text(manifest.read_text().replace("winter-dusk", "all"))
    line = expect_error(tmp_path, "evaluate", scene, "--method", "prior", "--out", tmp_path / "out")
    assert "no condition can be called 'all'" in line
    scored.write_text(scored.read_text().replace("same-flight", "all"))
    assert "no condition can be called 'all'" in expect_error(tmp_path, "leaderboard", scored)


HOSTILE = "\x1b[31m<b>|*x*|\n# forged\u202e $y$ `z`"


def test_names_are_text_wherever_they_are_written(scored: Path, tmp_path: Path) -> None:
    content = json.loads(scored.read_text())
    content["dataset"]["name"] = HOSTILE
    for query in content["queries"]:
        query["condition"] = HOSTILE
    content["by_condition"] = {HOSTILE: content["by_condition"]["same-flight"]}
    scored.write_text(json.dumps(content))
    text = leaderboard([scored], tmp_path)
    header = next(line for line in text.splitlines() if line.startswith("| method"))
    row = next(line for line in text.splitlines() if line.startswith("| elsewhere"))
    assert row.count(" | ") == header.count(" | ") > 8, "no cell more than the header has"
    written_out = [(tmp_path / f"leaderboard.{kind}").read_text("utf-8") for kind in ("md", "tex")]
    for each in [text, *written_out]:
        assert not any(sign in each for sign in "\x1b\u202e")
        assert "\n# forged" not in each
    assert "<b>" not in text
    page = (tmp_path / "leaderboard.html").read_text("utf-8")
    assert "\x1b" not in page
    assert "<b>|" not in page


def test_what_markdown_takes_for_markup() -> None:
    assert escape("sift (max_features=4096)") == "sift (max_features=4096)"
    assert escape("_a_ <b> [c](d) | e\n") == r"\_a\_ &lt;b&gt; \[c\](d) \| e\\n"


def test_a_name_with_dollars_can_be_drawn(
    flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Matplotlib takes what stands between two for a formula."""
    odd = r"b$\frac$.jpg"
    (flight / "images" / "b.jpg").rename(flight / "images" / odd)
    for name in ("queries.txt", "reference_poses.txt", "gps.csv"):
        text = (flight / name).read_text()
        (flight / name).write_text(text.replace("b.jpg", odd))
    method = FakeLocalizer({odd: Estimate(Status.OK, pose_at(1))})
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: method)
    answer = invoke("evaluate", flight, "--method", "fake", "--out", tmp_path / "out")
    assert answer.exit_code == 0, answer.stderr


# ---- what file managers leave


def test_strays_are_passed_over(
    flight: Path, photographs: Path, scored: Path, tmp_path: Path, method: FakeLocalizer
) -> None:
    for folder in (photographs, scored.parent):
        for name in ("._b.jpg", "._elsewhere.json", ".DS_Store", "Thumbs.db"):
            (folder / name).write_bytes(b"\0\5\26\7")
    out = tmp_path / "poses.txt"
    assert invoke(*localizing(flight, photographs, out)).exit_code == 0
    assert set(rows(out.with_suffix(".csv"))) == set(QUERY_NAMES)
    assert invoke("leaderboard", scored.parents[1]).exit_code == 0
    baseline = tmp_path / "baseline"
    assert invoke("regress", scored.parents[1], "--against", baseline, "--update").exit_code == 0
    assert [path.name for path in baseline.rglob("*.json")] == ["elsewhere.json"]


# ---- the gimbal's attitude


class Asked(FakeLocalizer):
    """Keeps the priors it is told."""

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        assert cache is not None, "methods are given room beside the output"
        self.kept = cache

    def told(self, name: str) -> Prior | None:
        """Of a photograph, when it was first asked for."""
        return next(query.prior for query in self.seen if query.name == name)


def with_gimbal(path: Path, yaw: float, pitch: float, roll: float) -> None:
    """A photograph as DJI writes them, 5 m east of the origin."""
    place = geodetic_from_enu(np.array([5.0, -3.0, 40.0]), ORIGIN)
    write_jpeg(path, np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8), Exif(place, None))
    xmp = (
        f'<x:xmpmeta><rdf:Description drone-dji:GimbalYawDegree="{yaw:+.2f}" '
        f'drone-dji:GimbalPitchDegree="{pitch:+.2f}" drone-dji:GimbalRollDegree="{roll:+.2f}"/>'
        "</x:xmpmeta>"
    )
    with Image.open(path) as image:
        image.save(path, exif=image.getexif(), xmp=xmp.encode())


def test_the_gimbal_tells_the_attitude(
    flight: Path, photographs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with_gimbal(photographs / "b.jpg", 0, -90, 0)
    with_gimbal(photographs / "d.jpg", 90, 0, 0)
    method = Asked({})
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: method)
    out = tmp_path / "poses.txt"
    assert invoke(*localizing(flight, photographs, out, "--gimbal-sigma", "3")).exit_code == 0
    assert not method.kept.exists(), "what is not kept goes"
    # Rows are the camera's axes, right, down and ahead, in east, north and up.
    known = {
        "b.jpg": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],  # looks down, the top of the picture north
        "d.jpg": [[0, -1, 0], [0, 0, -1], [1, 0, 0]],  # looks east
    }
    for name, rotation in known.items():
        prior = method.told(name)
        assert prior is not None
        assert prior.attitude_sigma_deg == 3
        assert prior.cam_from_world_rotation is not None
        np.testing.assert_allclose(prior.cam_from_world_rotation, rotation, atol=1e-9)
        np.testing.assert_allclose(prior.position, [5, -3, 40], atol=0.02)
    assert method.told("f.jpg") is None


class Misled(FakeLocalizer):
    """Finds nothing where it is told an attitude."""

    def localize(self, query: Query) -> Estimate:
        estimate = super().localize(query)
        told = query.prior is not None and query.prior.cam_from_world_rotation is not None
        return Estimate(Status.FALLBACK, pose_at(3), reason="the prior") if told else estimate


def test_a_picture_that_was_turned_over_is_asked_again(
    flight: Path, photographs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with_gimbal(photographs / "b.jpg", 0, -90, 180)
    with_gimbal(photographs / "d.jpg", 0, -90, 180)
    method = Misled({"b.jpg": Estimate(Status.OK, pose_at(1))})
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: method)
    out = tmp_path / "poses.txt"
    assert invoke(*localizing(flight, photographs, out)).exit_code == 0
    table = rows(out.with_suffix(".csv"))
    assert [table[name]["status"] for name in ("b.jpg", "d.jpg")] == ["ok", "fallback"]


def test_the_gimbal_of_a_real_flight(
    beach: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Within ten degrees of the reference, its compass included."""
    method = Asked({})
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: method)
    folder = tmp_path / "new"
    folder.mkdir()
    shutil.copy(beach / "photos" / "DJI_0019.jpg", folder)
    camera = ("--camera", "SIMPLE_RADIAL 1600 900 932.8125 800 450 0.003764")
    answer = invoke(*localizing(beach, folder, tmp_path / "poses.txt", *camera))
    assert answer.exit_code == 0, answer.stderr
    prior = method.told("DJI_0019.jpg")
    assert prior is not None
    assert prior.cam_from_world_rotation is not None
    truth = read_poses(beach / "reference_poses.txt")["DJI_0019.jpg"]
    cosine = (np.trace(prior.cam_from_world_rotation @ truth.rotation.numpy().T) - 1) / 2
    assert np.degrees(np.arccos(cosine)) < 10
    assert prior.attitude_sigma_deg == 5
    assert open_map(beach).origin is not None


def test_far_points_of_any_map(flight: Path) -> None:
    put_far_point(flight)
    with pytest.raises(InputError, match="lies more than"):
        read_model(flight / "sparse/map")
