from __future__ import annotations

from pathlib import Path

import pytest

from benchmark.report.board.figures import track_figures
from benchmark.report.board.pairing import reason_against
from benchmark.report.board.runs import BoardRun, read_board
from benchmark.results.results import Results
from benchmark.tracks.description import load_track, write_track
from objconnect.localization.provenance import Method
from objconnect.scene.errors import InputError
from tests.benchmark.report.board.made_board import write_board

NAME = "uav-seasons"
CONTROLS = {"pixloc": "objconnect"}


@pytest.fixture
def made(tmp_path: Path) -> Path:
    return write_board(tmp_path / "board", 2, [("town", 1), ("park", 1)])


def runs(made: Path) -> tuple[BoardRun, BoardRun]:
    """The control and the method that it belongs to."""
    by_method = {run.method: run for run in read_board(NAME, made).runs if run.start == "none"}
    return by_method["pixloc"], by_method["objconnect"]


def change(run: BoardRun, **changed: object) -> BoardRun:
    """The run with other results of one data set."""
    results: Results = run.results["town-1"].model_copy(update=changed)
    return BoardRun(run.start, run.method, run.answers, results={**run.results, "town-1": results})


def configure(run: BoardRun, config: dict[str, object]) -> BoardRun:
    return change(run, method=run.results["town-1"].method.model_copy(update={"config": config}))


def test_equal_runs_are_compared(made: Path) -> None:
    assert reason_against(CONTROLS, *runs(made), ["town-1", "park-1"]) == ""


def test_runs_on_different_renders_are_not_compared(made: Path) -> None:
    control, method = runs(made)
    dataset = method.results["town-1"].dataset.model_copy(update={"sha256": "0" * 64})
    other = change(method, dataset=dataset)
    assert "different renders of town-1" in reason_against({}, control, other, ["town-1"])
    assert reason_against({}, control, other, ["park-1"]) == ""


def test_runs_of_different_versions_are_not_compared(made: Path) -> None:
    control, method = runs(made)
    old = method.results["town-1"].environment.model_copy(update={"objconnect": "0.0.1"})
    reason = reason_against({}, control, change(method, environment=old), ["town-1"])
    assert "0.0.1 of objconnect" in reason


def test_poses_of_another_program_have_no_version(made: Path) -> None:
    control, method = runs(made)
    old = method.results["town-1"].environment.model_copy(update={"objconnect": "0.0.1"})
    theirs = change(method, environment=old, method=Method.external("theirs", "0" * 64))
    assert reason_against({}, control, theirs, ["town-1"]) == ""


def test_a_control_has_the_options_of_its_method(made: Path) -> None:
    control, method = runs(made)
    control = configure(control, {"search": {"risk": 0.05, "steps": 2}, "own": 1})
    method = configure(method, {"search": {"risk": 0.01, "steps": 2}, "objects": 1})
    assert reason_against(CONTROLS, control, method, ["town-1"]) == (
        "their options differ: search.risk"
    )
    assert reason_against(CONTROLS, method, control, ["town-1"]) != ""
    assert reason_against({}, control, method, ["town-1"]) == ""  # two methods, no control


def test_the_page_says_why_runs_are_not_compared(made: Path) -> None:
    track = load_track(NAME, made)
    write_track(track.model_copy(update={"controls": CONTROLS}), made)
    for path in made.rglob("none/town-1/pixloc.json"):
        path.write_text(path.read_text().replace('"config": {}', '"config": {"a": 1}'))
    for path in made.rglob("none/town-1/objconnect.json"):
        path.write_text(path.read_text().replace('"config": {}', '"config": {"a": 2}'))
    (start,) = (s for s in track_figures(read_board(NAME, made))["starts"] if s["name"] == "none")
    pairs = start["cells"][0]["pairs"][0]
    assert [pair.get("reason") for pair in pairs] == [None, None, "their options differ: a"]


def test_a_control_of_no_method_is_refused(made: Path) -> None:
    path = made / NAME / "track.yaml"
    path.write_text(path.read_text() + "controls: {pixloc: nothing}\n")
    with pytest.raises(InputError, match="nothing is none of the methods"):
        load_track(NAME, made)
