from __future__ import annotations

import csv
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from benchmark.cli import app
from benchmark.datasets.open import open_datasets
from benchmark.datasets.simulated import open_scene
from benchmark.results.results import DatasetId, Results
from benchmark.tracks import command
from benchmark.tracks.command import track
from benchmark.tracks.compact import write_compact
from benchmark.tracks.description import load_track
from benchmark.tracks.renders import difference, read_render, render_of
from objconnect.localization.provenance import Method
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.errors import InputError
from simulate.config import SimulateConfig
from tests.benchmark.made_data import make_scored_query, write_flight, write_scene
from tests.conftest import RENDERED
from tests.objconnect.scene.exports.test_cmu import street as street  # a fixture

Snapshot = dict[str, int]


def write_board(root: Path, preset: str = "town", seeds: tuple[int, ...] = (11,)) -> Path:
    """A track whose places are those of the tests' rendered scene."""
    config = RENDERED.model_dump(mode="json", exclude={"preset", "seed"})
    (root / "config.yaml").write_text(yaml.safe_dump(config))
    places = [{"dataset": f"{preset}-{seed}", "preset": preset, "seed": seed} for seed in seeds]
    description = {"name": "tiny", "title": "Tiny", "config": str(root / "config.yaml")}
    lists: dict[str, Any] = {"places": places, "starts": ["none"], "methods": ["sift"]}
    (root / "board" / "tiny").mkdir(parents=True)
    (root / "board" / "tiny" / "track.yaml").write_text(yaml.safe_dump(description | lists))
    return root / "board"


@pytest.fixture
def board(tmp_path: Path) -> Path:
    return write_board(tmp_path)


@pytest.fixture
def out(rendered: Scene, tmp_path: Path) -> Path:
    """The folder of the scenes, with the place rendered and mapped."""
    shutil.copytree(rendered.path, tmp_path / "out" / "town-11")
    return tmp_path / "out"


def write(folder: Path) -> Snapshot:
    return {str(path): path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


def test_a_finished_place_is_compared_and_left_alone(out: Path, board: Path) -> None:
    before = write(out) | write(board)
    report = track("tiny", out, tracks_folder=board)
    assert write(out) | write(board) == before
    (place,) = report.places
    assert place.sha256 == open_scene(out / "town-11").sha256
    assert (place.queries, place.recorded_digests, place.same, place.export) == (7, (), None, None)
    assert report.text() == f"town-11: 7 queries, data set {place.sha256[:12]}, not recorded yet"


def test_update_records_renders_and_queries(out: Path, board: Path) -> None:
    report = track("tiny", out, tracks_folder=board, update=True)
    table = board / "tiny" / "queries" / "town-11.csv"
    render = board / "tiny" / "renders" / "town-11.json.xz"
    assert report.written == (table, render, board / "tiny" / "track.yaml")
    assert difference(read_render(render), render_of(Scene.open(out / "town-11"))) == ""
    assert load_track("tiny", board).places[0].renders == (report.places[0].sha256,)
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    (dataset,) = open_datasets(out / "town-11")
    assert [row["name"] for row in rows] == [query.name for query in dataset.queries]
    assert {row["part"] for row in rows} == {"town"}
    for row, query in zip(rows, dataset.queries, strict=True):
        assert (row["condition"], row["flight"]) == (query.condition, query.group)
        assert 0 < float(row["overlap"]) <= 1
        assert 0.3 < float(row["scale"]) < 3
        assert int(row["days"]) == 0 if row["condition"] == "summer-noon" else int(row["days"]) > 90
    again = track("tiny", out, tracks_folder=board)
    assert again.places[0].same is True
    assert again.text().endswith(", as recorded")
    assert again.as_dict()["differing"] == []


def test_a_render_of_another_machine_is_the_same_data_set(out: Path, board: Path) -> None:
    """Its bytes differ and its pictures do not: results on both can be compared."""
    first = track("tiny", out, tracks_folder=board, update=True).places[0].sha256
    photograph = next((out / "town-11" / "sessions").rglob("*.jpg"))
    photograph.write_bytes(photograph.read_bytes() + b"\0")
    report = track("tiny", out, tracks_folder=board)
    assert report.differing == ()
    assert report.text().endswith(f", like the recorded {first[:12]} but for rounding")
    before = write(board / "tiny" / "renders") | write(board / "tiny" / "queries")
    track("tiny", out, tracks_folder=board, update=True)
    assert write(board / "tiny" / "renders") | write(board / "tiny" / "queries") == before
    second = report.places[0].sha256
    assert load_track("tiny", board).places[0].renders == (first, second)
    assert track("tiny", out, tracks_folder=board).text().endswith(", as recorded")


def test_a_record_that_is_missing_is_named(out: Path, board: Path) -> None:
    """A board of before has digests alone; a digest that is another one tells nothing more."""
    track("tiny", out, tracks_folder=board, update=True)
    (board / "tiny" / "renders" / "town-11.json.xz").unlink()
    assert track("tiny", out, tracks_folder=board).differing == ()
    photograph = next((out / "town-11" / "sessions").rglob("*.jpg"))
    photograph.write_bytes(photograph.read_bytes() + b"\0")
    report = track("tiny", out, tracks_folder=board)
    assert "there is no town-11.json.xz to compare with" in report.text()
    assert report.differing == ("town-11",)


def test_another_render_is_named(out: Path, board: Path) -> None:
    """A photograph shows something else; the results of that place can not be compared."""
    track("tiny", out, tracks_folder=board, update=True)
    (recorded,) = load_track("tiny", board).places[0].renders
    one, other, *_ = sorted((out / "town-11" / "sessions").rglob("*.jpg"))
    one.write_bytes(other.read_bytes())
    report = track("tiny", out, tracks_folder=board)
    assert report.differing == ("town-11",)
    first, note = report.text().splitlines()
    name = one.relative_to(out / "town-11" / "sessions")
    assert f"NOT the recorded {recorded[:12]} ({name} differs by " in first
    assert note.startswith(f"Note: the results of town-11 in {board / 'tiny'} cannot be compared")
    assert report.as_dict()["places"][0]["same"] is False
    assert load_track("tiny", board).places[0].renders == (recorded,), "nothing is recorded unasked"
    renewed = track("tiny", out, tracks_folder=board, update=True)
    assert "earlier data sets" in renewed.text().splitlines()[-1]
    assert track("tiny", out, tracks_folder=board).differing == ()


def write_flights(tmp_path: Path) -> Path:
    """A track of one flight, beside the flight."""
    board = tmp_path / "board"
    (board / "flown").mkdir(parents=True)
    lists = {"places": [{"dataset": "meadow"}], "starts": ["none"], "methods": ["sift"]}
    text = yaml.safe_dump({"name": "flown", "title": "Flown", **lists})
    (board / "flown" / "track.yaml").write_text(text)
    write_flight(tmp_path / "flights" / "meadow")
    return board


def test_flights_are_read_and_recorded(tmp_path: Path) -> None:
    board, flights = write_flights(tmp_path), tmp_path / "flights"
    before = write(flights)
    first = track("flown", tracks_folder=board, flights=flights)
    assert first.text().endswith(", not recorded yet")
    recorded = track("flown", tracks_folder=board, flights=flights, update=True)
    table = board / "flown" / "queries" / "meadow.csv"
    assert recorded.written == (table, board / "flown" / "track.yaml")
    assert track("flown", tracks_folder=board, flights=flights).text().endswith(", as recorded")
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    (dataset,) = open_datasets(flights / "meadow")
    assert [row["name"] for row in rows] == [query.name for query in dataset.queries]
    assert {row["part"] for row in rows} == {"meadow"}
    assert {float(row["scale"]) for row in rows} == {1.0}, "from the same height"
    assert all(0.5 < float(row["overlap"]) < 1 for row in rows)
    assert write(flights) == before
    (flights / "meadow" / "gps.csv").unlink()
    assert track("flown", tracks_folder=board, flights=flights).differing == ("meadow",)


def test_flights_that_are_absent_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    board = write_flights(tmp_path)
    with pytest.raises(InputError, match="--flights or the variable OBJCONNECT_REAL"):
        track("flown", tracks_folder=board)
    with pytest.raises(InputError, match="does not hold the flight meadow of flown"):
        track("flown", tracks_folder=board, flights=tmp_path)
    monkeypatch.setenv("OBJCONNECT_REAL", str(tmp_path / "flights"))
    result = CliRunner().invoke(app, ["track", "flown", "--board", str(board)])
    assert result.exit_code == 0 and "meadow: 3 queries" in result.output


def test_the_flights_of_real_seasons_are_those_of_its_results(real_seasons: Path) -> None:
    report = track("real-seasons", flights=real_seasons)
    assert [place.text().rpartition(", ")[2] for place in report.places] == ["as recorded"] * 2


def test_a_map_that_was_not_finished_is_built(out: Path, board: Path) -> None:
    """Killed after the map and before the manifest, or before the map: both give the same data."""
    place = out / "town-11"
    before = track("tiny", out, tracks_folder=board).places[0].sha256
    shutil.rmtree(place / "map")
    finish_scene(place, Scene.open(place).manifest)
    assert track("tiny", out, tracks_folder=board).places[0].sha256 == before
    assert Scene.open(place).find_changed_files() == []


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """What the renderer and the builder of maps are asked for, in place of hours of work."""
    calls: list[tuple[Any, ...]] = []

    def simulate(config: SimulateConfig, path: Path, jobs: int, cluster: str | None) -> Scene:
        calls.append((path.name, config.preset, config.seed, jobs, cluster))
        if not path.exists():
            write_scene(path)
            shutil.rmtree(path / "map")
            finish_scene(path, Scene.open(path).manifest)
        return Scene.open(path)

    def build(path: Path, cluster: str | None) -> None:
        calls.append(("map", path.name, cluster))
        write_scene(path.with_name("whole"))
        shutil.move(path.with_name("whole") / "map", path / "map")
        shutil.rmtree(path.with_name("whole"))
        finish_scene(path, Scene.open(path).manifest)

    monkeypatch.setattr(command, "simulate", simulate)
    monkeypatch.setattr(command, "build_map", build)
    return calls


def test_every_place_is_rendered_and_mapped(tmp_path: Path, asked: list[tuple[Any, ...]]) -> None:
    board = write_board(tmp_path, seeds=(1, 2))
    report = track("tiny", tmp_path / "out", jobs=3, cluster="local", tracks_folder=board)
    assert asked == [
        ("town-1", "town", 1, 3, "local"),
        ("map", "town-1", "local"),
        ("town-2", "town", 2, 3, "local"),
        ("map", "town-2", "local"),
    ]
    assert [place.scene for place in report.places] == [
        tmp_path / "out" / name for name in ("town-1", "town-2")
    ]
    asked.clear()
    (one,) = track("tiny", tmp_path / "elsewhere", ["town-2"], tracks_folder=board).places
    assert [call[0] for call in asked] == ["town-2", "map"]
    assert one.dataset == "town-2"


def test_a_wrong_folder_is_refused_before_rendering(
    tmp_path: Path, asked: list[tuple[Any, ...]]
) -> None:
    board = write_board(tmp_path, seeds=(1, 2))
    (tmp_path / "out" / "town-2").mkdir(parents=True)
    (tmp_path / "out" / "town-2" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="town-2 is not empty and not a scene"):
        track("tiny", tmp_path / "out", tracks_folder=board)
    assert asked == []


def test_streets_are_exported(
    street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "track").mkdir()
    board = write_board(tmp_path / "track", "street", (7,))
    (tmp_path / "out").mkdir()
    monkeypatch.setattr(command, "find_finished", lambda *_: None)
    monkeypatch.setattr(
        command, "simulate", lambda *_: Scene.open(Path(street.rename(tmp_path / "out/street-7")))
    )
    (place,) = track("tiny", tmp_path / "out", tracks_folder=board).places
    assert place.export == tmp_path / "out" / "street-7-cmu"
    assert place.sha256 == open_scene(tmp_path / "out" / "street-7").sha256
    assert {d.name for d in open_datasets(place.export)} >= {"cmu-urban-slice2", "cmu-park-slice18"}
    before = write(place.export)
    monkeypatch.setattr(command, "simulate", lambda *_: Scene.open(place.scene))
    track("tiny", tmp_path / "out", tracks_folder=board)
    assert write(place.export) == before


def test_results_do_not_hinder(out: Path, board: Path) -> None:
    """The board holds results beside the description; the command leaves them alone."""
    results = Results.of(
        Method(name="sift", config={}, weights_sha256=None),
        DatasetId(name="town-11", track="uav-sim", sha256="ab", map_conditions=()),
        "none",
        [make_scored_query("a", 0.1)],
    )
    path = board / "tiny" / "results" / "none" / "town-11" / "sift.json.xz"
    write_compact(path, results)
    before = path.read_bytes()
    track("tiny", out, tracks_folder=board, update=True)
    assert path.read_bytes() == before


@pytest.mark.thorough
def test_a_track_is_rendered_and_rendered_again_alike(tmp_path: Path) -> None:
    """A fresh render on this machine reproduces the recorded digest."""
    sessions = [
        {"name": "map", "condition": "summer-noon", "flight": "nadir", "role": "map", "frames": 6},
        {"name": "same", "condition": "summer-noon", "flight": "nadir", "role": "query"},
    ]
    board = write_board(tmp_path, "park")
    config = {"area": 120, "size": 160, "spp": 1, "frames": 2, "sessions": sessions}
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(config))
    first = track("tiny", tmp_path / "first", tracks_folder=board, update=True)
    second = track("tiny", tmp_path / "second", tracks_folder=board)
    assert first.places[0].sha256 == second.places[0].sha256
    assert second.places[0].same is True
