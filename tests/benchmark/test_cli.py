"""The command line, mainly its error messages for faulty input."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from pydantic import BaseModel, Field
from typer.testing import CliRunner, Result

import objconnect.methods
from benchmark.cli import app
from benchmark.cli.arguments import parse_settings
from benchmark.cli.commands import COMMANDS, CommandGroup
from benchmark.cli.options import options_of
from benchmark.cli.output import Summary, emit
from objconnect.methods import METHODS, create
from objconnect.scene.localizer import Estimate, Status
from tests.benchmark.made_data import FakeLocalizer, move, pose_at, write_flight, write_model

ROOT = Path(__file__).parents[2]


def invoke(*words: object) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def error_line(stderr: str) -> str:
    """The one line a person reads."""
    assert "Traceback" not in stderr
    lines = stderr.splitlines()
    assert len(lines) == 1, stderr
    assert lines[0].startswith("objconnect: error: ")
    return lines[0]


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeLocalizer:
    """Every method name gives this localizer."""
    localizer = FakeLocalizer(
        {
            "b.jpg": Estimate(Status.OK, move(pose_at(1), 0.1)),
            "d.jpg": Estimate(Status.OK, move(pose_at(3), 0.1)),
        }
    )
    monkeypatch.setattr(objconnect.methods, "create", lambda name, overrides: localizer)
    return localizer


def first_query(flight: Path) -> str:
    return (flight / "queries.txt").read_text().split()[0]


def edit_pose(flight: Path, column: int, value: str) -> None:
    """Change one column of the first reference pose."""
    path = flight / "reference_poses.txt"
    lines = path.read_text().splitlines()
    words = lines[1].split()
    words[column] = value
    path.write_text("\n".join([lines[0], " ".join(words), *lines[2:]]) + "\n")


def nan_pose(flight: Path) -> str:
    edit_pose(flight, 6, "nan")
    return "reference_poses.txt:2: 'nan' is not a finite number"


def not_a_number(flight: Path) -> str:
    edit_pose(flight, 2, "west")
    return "reference_poses.txt:2: 'west' is not a number"


def non_unit_quaternion(flight: Path) -> str:
    edit_pose(flight, 1, "0.9")
    return f"reference_poses.txt:2: {first_query(flight)} has a quaternion of length"


def wrong_column_count(flight: Path) -> str:
    edit_pose(flight, 7, "1.0 2.0")
    return "reference_poses.txt:2: expected 8 columns (name qw qx qy qz tx ty tz), got 9"


def wrong_camera(flight: Path) -> str:
    path = flight / "queries.txt"
    path.write_text(path.read_text().replace(" SIMPLE_RADIAL ", " PINHOLEY ", 1))
    return "queries.txt:1: unknown camera model 'PINHOLEY'"


def duplicate_query(flight: Path) -> str:
    path = flight / "queries.txt"
    path.write_text(path.read_text() + path.read_text().splitlines()[0] + "\n")
    return f"{first_query(flight)} is listed twice"


def query_without_reference(flight: Path) -> str:
    path = flight / "reference_poses.txt"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], *lines[2:]]) + "\n")
    return f"query {first_query(flight)} has no reference pose"


def reference_without_query(flight: Path) -> str:
    name = first_query(flight)
    path = flight / "queries.txt"
    path.write_text("\n".join(path.read_text().splitlines()[1:]) + "\n")
    return f"{name} is not a query of"


def no_queries(flight: Path) -> str:
    (flight / "queries.txt").write_text("# none\n")
    (flight / "reference_poses.txt").write_text("# none\n")
    return "queries.txt lists no query"


def missing_image(flight: Path) -> str:
    (flight / "images" / first_query(flight)).unlink()
    return f"{first_query(flight)} does not exist"


def missing_poses(flight: Path) -> str:
    (flight / "reference_poses.txt").unlink()
    return "reference_poses.txt"


def binary_poses(flight: Path) -> str:
    (flight / "reference_poses.txt").write_bytes(b"\xff\xfe\x00")
    return "reference_poses.txt: it is not a UTF-8 text file"


def missing_map(flight: Path) -> str:
    shutil.rmtree(flight / "sparse")
    return "sparse/map"


def empty_map(flight: Path) -> str:
    shutil.rmtree(flight / "sparse" / "map")
    write_model(flight / "sparse" / "map", {})
    return "is empty"


def truncate_map(flight: Path) -> str:
    path = flight / "sparse" / "map" / "points3D.bin"
    path.write_bytes(path.read_bytes()[:1000])
    return "points3D.bin is truncated or damaged"


def query_in_the_map(flight: Path) -> str:
    shutil.rmtree(flight / "sparse" / "map")
    write_model(flight / "sparse" / "map", {first_query(flight): pose_at(1)})
    return f"query {first_query(flight)} is a photograph of the map"


def bad_gps(flight: Path) -> str:
    path = flight / "gps.csv"
    path.write_text(path.read_text().replace(",map,", ",map,,", 1))
    return "gps.csv:2: expected"


def gps_without_columns(flight: Path) -> str:
    path = flight / "gps.csv"
    path.write_text(path.read_text().replace(",e,n,u", ",x,y,z", 1))
    return "gps.csv:1: GPS table lacks the column e, n, u"


@pytest.mark.parametrize(
    "damage",
    [
        nan_pose,
        not_a_number,
        non_unit_quaternion,
        wrong_column_count,
        wrong_camera,
        duplicate_query,
        query_without_reference,
        reference_without_query,
        no_queries,
        missing_image,
        missing_poses,
        binary_poses,
        missing_map,
        empty_map,
        truncate_map,
        query_in_the_map,
        bad_gps,
        gps_without_columns,
    ],
)
def test_a_broken_flight_is_one_error_line(
    flight: Path, tmp_path: Path, damage: Callable[[Path], str]
) -> None:
    message = damage(flight)
    result = invoke("evaluate", flight, "--method", "sift", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert message in error_line(result.stderr)
    assert result.stdout == ""
    assert not (tmp_path / "out").exists()


def truncate_photograph(flight: Path) -> str:
    path = flight / "images" / first_query(flight)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return f"{path} is damaged"


def photograph_of_another_size(flight: Path) -> str:
    from PIL import Image

    path = flight / "images" / first_query(flight)
    Image.new("RGB", (40, 30)).save(path)
    return f"{path} is 40 x 30 pixels but its camera is"


@pytest.mark.parametrize("damage", [truncate_photograph, photograph_of_another_size])
def test_a_broken_photograph_is_one_error_line(
    flight: Path, tmp_path: Path, fake: FakeLocalizer, damage: Callable[[Path], str]
) -> None:
    message = damage(flight)
    result = invoke("evaluate", flight, "--method", "fake", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert message in error_line(result.stderr)
    assert not (tmp_path / "out").exists()


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    nowhere = tmp_path / "nowhere"
    result = invoke("evaluate", nowhere, "--method", "sift", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert f"data set {nowhere} does not exist" in error_line(result.stderr)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_a_data_set_is_refused(tmp_path: Path) -> None:
    result = invoke("evaluate", tmp_path, "--method", "sift", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "is not a data set" in error_line(result.stderr)


def test_an_unknown_method_is_refused(made_flight: Path, tmp_path: Path) -> None:
    result = invoke("evaluate", made_flight, "--method", "magic", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "unknown method 'magic'" in error_line(result.stderr)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("charm=1", "charm"),
        ("ratio=high", "ratio"),
        ("ratio", "--set takes KEY=VALUE"),
        ("ratio=[", "is not a YAML value"),
    ],
)
def test_a_bad_setting_is_refused(
    made_flight: Path, tmp_path: Path, setting: str, message: str
) -> None:
    out = tmp_path / "out"
    result = invoke("evaluate", made_flight, "--method", "sift", "--out", out, "--set", setting)
    assert result.exit_code == 2
    assert message in error_line(result.stderr)


@pytest.mark.parametrize("option", ["matches", "objects"])
def test_null_switches_an_option_off(option: str) -> None:
    """As the documents say of both."""
    switched = create("objconnect", parse_settings([f"{option}=null"]))
    assert getattr(switched.config, option) is None
    assert getattr(create("objconnect", {}).config, option) is not None


def test_two_data_sets_with_one_name_are_refused(tmp_path: Path, fake: FakeLocalizer) -> None:
    one, two = write_flight(tmp_path / "1" / "meadow"), write_flight(tmp_path / "2" / "meadow")
    result = invoke("evaluate", one, two, "--method", "fake", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "two data sets are called 'meadow'" in error_line(result.stderr)
    result = invoke("evaluate", one, one / ".", "--method", "fake", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "is given 2 times" in error_line(result.stderr)


def test_evaluate_writes_results_that_leaderboard_reads(
    made_flight: Path, tmp_path: Path, fake: FakeLocalizer
) -> None:
    out = tmp_path / "out"
    result = invoke("evaluate", made_flight, "--method", "fake", "--out", out)
    assert result.exit_code == 0, result.output
    assert "| fake | same-flight | 3 | 1 | 66.7 [–] |" in result.stdout
    board = invoke("leaderboard", out, "--out", tmp_path / "board")
    assert board.exit_code == 0
    assert (tmp_path / "board" / "leaderboard.md").read_text() == board.stdout
    assert board.stdout.startswith(result.stdout)


def test_evaluate_prints_json(made_flight: Path, tmp_path: Path, fake: FakeLocalizer) -> None:
    out = tmp_path / "out"
    words = ["evaluate", made_flight, "--method", "fake", "--out", out, "--start", "none", "--json"]
    summary = json.loads(invoke(*words).stdout)
    assert summary["results"] == [str(out / "meadow" / "fake.json")]
    (table,) = summary["tables"]
    assert (table["dataset"], table["start"]) == ("meadow", "none")
    assert table["rows"][0]["summary"]["queries"] == 3
    assert json.loads(invoke("leaderboard", out, "--json").stdout)["tables"] == summary["tables"]


def test_basin_writes_a_level_for_each_size(
    made_flight: Path, tmp_path: Path, fake: FakeLocalizer
) -> None:
    out = tmp_path / "out"
    words = ["basin", made_flight, "--method", "fake", "--out", out, "--errors", "0m/0deg,3m/5deg"]
    result = invoke(*words)
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[0] == str(out / "meadow" / "fake.basin.json")
    assert "prior 3 m 5°: 66.7 [–] % at 0.25 m 2°" in result.stdout
    summary = json.loads(invoke(*words, "--json").stdout)
    (found,) = summary["basins"].values()
    assert [level["queries"] for level in found["levels"]] == [3, 3]


def test_basin_refuses_a_malformed_size(
    made_flight: Path, tmp_path: Path, fake: FakeLocalizer
) -> None:
    words = ["basin", made_flight, "--method", "fake", "--out", tmp_path / "out"]
    result = invoke(*words, "--errors", "3m,5deg")
    assert result.exit_code == 2
    assert "write errors as 1m/2deg,3m/5deg; got '3m'" in error_line(result.stderr)
    assert not (tmp_path / "out").exists()


def test_an_interrupt_ends_with_code_130(
    made_flight: Path, tmp_path: Path, fake: FakeLocalizer
) -> None:
    fake.answers = {"d.jpg": KeyboardInterrupt()}
    result = invoke("evaluate", made_flight, "--method", "fake", "--out", tmp_path / "out")
    assert result.exit_code == 130
    assert "Traceback" not in result.stderr
    assert not list((tmp_path / "out").rglob("*.json"))


def test_leaderboard_refuses_a_folder_without_results(tmp_path: Path) -> None:
    result = invoke("leaderboard", tmp_path, "--out", tmp_path / "board")
    assert result.exit_code == 2
    assert "holds no results file" in error_line(result.stderr)
    assert not (tmp_path / "board").exists()


@pytest.mark.parametrize(
    "command", ["evaluate", "basin", "leaderboard", "simulate", "map", "dense", "validate"]
)
def test_help_is_complete(command: str) -> None:
    result = invoke(command, "--help")
    assert result.exit_code == 0
    assert "--json" in result.stdout


def test_version_is_printed() -> None:
    result = invoke("--version")
    assert result.exit_code == 0
    assert result.stdout.startswith("objconnect")


def test_an_unknown_option_is_refused() -> None:
    assert invoke("evaluate", "--colour", "red").exit_code == 2


def test_simulate_passes_its_options_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[Any, ...]] = []

    def simulate(*call: Any) -> SimpleNamespace:
        calls.append(call)
        return SimpleNamespace(path=tmp_path / "scene", sessions={"summer-noon-nadir-map": None})

    monkeypatch.setattr("simulate.command.simulate", simulate)
    config = tmp_path / "c.yaml"
    config.write_text("spp: 9\nframes: 5\n")
    words = ["simulate", "--out", tmp_path / "scene", "--config", config, "--seed", 7, "--jobs", 2]
    sessions = ["--session", "summer-noon:nadir", "--session", "winter-dusk:oblique:query"]
    result = invoke(*words, "--frames", 8, *sessions, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["sessions"] == ["summer-noon-nadir-map"]
    ((settings, out, jobs, cluster),) = calls
    assert (out, jobs, cluster) == (tmp_path / "scene", 2, None)
    assert (settings.seed, settings.spp, settings.frames) == (7, 9, 8)
    assert [(s.condition, s.flight.kind, s.role) for s in settings.sessions] == [
        ("summer-noon", "nadir", "map"),
        ("winter-dusk", "oblique", "query"),
    ]


def test_simulate_refuses_an_export_folder_that_is_not_empty(tmp_path: Path) -> None:
    """And says so before it renders anything."""
    kept = tmp_path / "scene-cmu" / "mine.txt"
    kept.parent.mkdir()
    kept.write_text("mine")
    words = ["--preset", "street", "--out", tmp_path / "scene", "--export", "cmu"]
    result = invoke("simulate", *words)
    assert result.exit_code == 2
    assert "scene-cmu is not empty: choose another folder" in result.stderr
    assert not (tmp_path / "scene").exists()
    assert kept.read_text() == "mine"


@pytest.mark.parametrize(
    "words", [["--preset", "moon"], ["--session", "summer-noon"], ["--session", "rain:nadir"]]
)
def test_simulate_refuses_unknown_names(tmp_path: Path, words: list[str]) -> None:
    result = invoke("simulate", "--out", tmp_path / "scene", *words)
    assert result.exit_code == 2
    assert words[1].split(":")[0] in error_line(result.stderr)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["map", "dense"])
def test_a_missing_scene_is_refused(tmp_path: Path, command: str) -> None:
    result = invoke(command, tmp_path)
    assert result.exit_code == 2
    assert "is not a finished scene" in error_line(result.stderr)


@pytest.mark.parametrize(("ok", "code"), [(True, 0), (False, 2)])
def test_validate_exits_with_2_on_a_failed_check(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, ok: bool, code: int
) -> None:
    report = SimpleNamespace(ok=ok, text=lambda: "the findings", as_dict=lambda: {"ok": ok})
    module = SimpleNamespace(validate=lambda path, cache: report)
    monkeypatch.setitem(sys.modules, "benchmark.validation", module)
    result = invoke("validate", tmp_path)
    assert (result.exit_code, result.stdout) == (code, "the findings\n")
    result = invoke("validate", tmp_path, "--json")
    assert (result.exit_code, json.loads(result.stdout)) == (code, {"ok": ok})


def run_process(*words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "benchmark.cli", *(str(word) for word in words)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_process_prints_one_line(made_flight: Path, tmp_path: Path) -> None:
    message = nan_pose(made_flight)
    done = run_process("evaluate", made_flight, "--method", "sift", "--out", tmp_path / "out")
    assert done.returncode == 2
    assert message in error_line(done.stderr)
    assert done.stdout == ""
    assert not (tmp_path / "out").exists()


def test_help_is_quick() -> None:
    """Loading modules takes the time of a short command: help needs few, and none that computes."""
    command = [sys.executable, "-X", "importtime", "-m", "benchmark.cli", "--help"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    lines = [line for line in done.stderr.splitlines() if line.startswith("import time:")]
    loaded = {line.rpartition("|")[2].strip() for line in lines}
    assert {"typer", "benchmark.cli"} <= loaded
    assert len(loaded) < 360, "180 suffice"
    assert not loaded & {"torch", "numpy", "rich.progress"}
    assert not list_loaded_with("benchmark.cli") & {"torch", "numpy", "rich.progress"}
    assert not list_loaded_with("benchmark.cli.simulation") & {"torch", "pycolmap", "bpy"}


def list_loaded_with(module: str) -> set[str]:
    """Names of all modules that are loaded when one is imported by a fresh interpreter."""
    told = f"import sys, {module}; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", told], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_the_list_of_commands_quotes_their_help() -> None:
    """The list is written by hand, because reading it from the commands would load them all."""
    for summaries in COMMANDS.values():
        for name, summary in summaries.items():
            text = " ".join(CommandGroup().commands[name].help.split())
            assert text.startswith(summary), name


class Weather(BaseModel):
    """What a flight meets."""

    wind: float = Field(1.0, description="Speed of the ``wind``, metres per second.")
    rain: int = Field(2, description="Millimetres per hour.")


def test_fields_of_a_configuration_become_options() -> None:
    calls: list[tuple[Any, ...]] = []
    small = typer.Typer(rich_markup_mode=None)

    @small.command()
    @options_of(Weather, "wind", "rain", defaults={"rain": 5})
    def fly(place: str, settings: dict[str, Any], height: int = 3) -> None:
        """Fly."""
        calls.append((place, settings, height))

    runner = CliRunner()
    assert runner.invoke(small, ["here"]).exit_code == 0
    assert runner.invoke(small, ["here", "--wind", "7", "--height", "4"]).exit_code == 0
    assert runner.invoke(small, ["here", "--rain", "much"]).exit_code == 2
    assert calls == [
        ("here", {"wind": None, "rain": 5}, 3),
        ("here", {"wind": 7.0, "rain": 5}, 4),
    ]
    text = " ".join(runner.invoke(small, ["--help"]).stdout.split())
    assert "--wind <float> Speed of the wind, metres per second." in text
    assert "--rain <int> Millimetres per hour. [default: 5]" in text


@pytest.mark.parametrize("method", METHODS)
def test_every_option_that_is_listed_can_be_set(method: str) -> None:
    result = invoke("options", method, "--json")
    assert result.exit_code == 0, result.stderr
    listed = json.loads(result.stdout)["options"]
    assert all(option["description"] for option in listed)
    defaults = create(method, {}).config
    assert {option["key"] for option in listed} >= set(type(defaults).model_fields)
    settings = {o["key"]: o["default"] for o in listed if not isinstance(o["default"], dict)}
    assert create(method, settings).config == defaults


def test_options_are_printed_as_they_are_set() -> None:
    lines = invoke("options", "objconnect").stdout.splitlines()
    assert {"search (group)", "search.risk=0.05", "weights=null"} <= set(lines)
    assert invoke("options", "prior").stdout == "prior has no options\n"


def test_text_ends_in_one_line_break(capsys: pytest.CaptureFixture[str]) -> None:
    for text in ("one\ntwo", "one\ntwo\n"):
        emit(Summary(text, {}), as_json=False)
        assert capsys.readouterr().out == "one\ntwo\n"
    emit(Summary("", {"path": Path("a/b"), "degrees": 1.5}), as_json=True)
    assert json.loads(capsys.readouterr().out) == {"path": "a/b", "degrees": 1.5}
