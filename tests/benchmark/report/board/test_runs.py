from __future__ import annotations

import json
import logging
import shutil
from pathlib import Path

import pytest

from benchmark.report.board.cells import cells
from benchmark.report.board.command import board
from benchmark.report.board.figures import track_figures
from benchmark.report.board.runs import read_board, read_boards
from benchmark.results.results import rescore
from benchmark.results.results_files import load
from benchmark.scoring.score import THRESHOLDS
from benchmark.tracks.compact import write_compact
from benchmark.tracks.description import load_track, write_track
from objconnect.localization.provenance import Method
from objconnect.scene.errors import InputError
from objconnect.scene.flights.reference_error import ReferencePoseError
from tests.benchmark.report.board.made_board import write_board

NAME = "uav-seasons"
START = "error=3m,5deg"


@pytest.fixture
def made(tmp_path: Path) -> Path:
    return write_board(tmp_path / "board")


def results_path(made: Path, dataset: str = "town-1", method: str = "pixloc") -> Path:
    return made / NAME / "results" / START / dataset / f"{method}.json"


def test_every_query_has_the_answers_of_its_own_data_set(made: Path) -> None:
    (found,) = read_boards(made)
    assert len(found.queries) == 3 * 3 * 8
    assert not found.missing
    assert [(run.start, run.method) for run in found.runs[:4]] == [
        (START, "sift"),
        (START, "pixloc"),
        (START, "objconnect"),
        ("none", "sift"),
    ]
    k = next(k for k, query in enumerate(found.queries) if query.dataset == "town-2")
    given = load(results_path(made, "town-2")).queries[0]
    assert found.runs[1].answers[k] == given.model_copy(update={"course": f"town-2/{given.group}"})
    assert found.runs[1].correct[:, k].tolist() == [
        given.t_err_m is not None and given.t_err_m < threshold.metres for threshold in THRESHOLDS
    ]
    assert {q.row.condition for q in found.queries if q.same} == {"summer-noon"}
    assert len(set(found.courses)) == 9


def test_the_track_of_aircraft_comes_first(made: Path) -> None:
    """Before others with results, whatever their names are, and those without come last."""
    track = load_track(NAME, made)
    for name in ("a-street", "b-empty", "z-street"):
        write_track(track.model_copy(update={"name": name}), made)
        if "empty" not in name:
            for part in ("queries", "results"):
                shutil.copytree(made / NAME / part, made / name / part)
    assert [board.track.name for board in read_boards(made)] == [
        *(NAME, "a-street", "z-street", "b-empty"),
    ]


def test_a_declared_start_is_said(made: Path, tmp_path: Path) -> None:
    """Poses of another program, whose start nobody verified, stand among runs of ours."""
    for dataset in ("park-1", "town-1", "town-2"):
        path = results_path(made, dataset)
        theirs = Method.external("pixloc", "0" * 64)
        load(path).model_copy(update={"method": theirs}).write(path)
    shown = board(made, tmp_path / "page")
    assert "| pixloc (start as declared) |" in shown.text()
    assert "sift (start as declared)" not in shown.text()
    (found,) = read_boards(made)
    declared = [run.start for run in found.runs if run.declared]
    assert declared == [START], "from the other start it is ours"
    assert "pixloc (start as declared)" in (tmp_path / "page" / "leaderboard.html").read_text()


def test_figures_pool_the_data_sets(made: Path) -> None:
    """Counted anew from the files themselves."""
    right = total = 0
    for dataset in ("park-1", "town-1", "town-2"):
        for query in json.loads(results_path(made, dataset).read_text())["queries"]:
            if query["condition"] != "summer-noon":
                total += 1
                right += query["status"] == "ok" and query["t_err_m"] < 0.5
    (row,) = (
        row
        for row in board(made).rows[0]
        if (row.start, row.season, row.part, row.method) == (START, "changed", "all", "pixloc")
    )
    assert row.summary.queries == total == 48
    assert row.summary.recall["0.5m_5deg"].value == pytest.approx(100 * right / total)
    text = board(made).text()
    assert f"| changed | all | pixloc | 48 | {row.summary.courses} |" in text
    assert row.summary.courses == 6
    paper = next(line for line in text.splitlines() if line.startswith("| pixloc | measured here"))
    assert f"{100 * right / total:.1f} [" in paper
    assert "| – | – | – |" in paper


def test_compressed_results_count_alike(made: Path) -> None:
    before = board(made).rows
    path = results_path(made)
    write_compact(path.with_suffix(".json.xz"), load(path))
    path.unlink()
    after = board(made).rows
    for one, two in zip(before[0], after[0], strict=True):
        assert one.summary.recall == two.summary.recall
        assert one.summary.integrity() == two.summary.integrity()


def test_what_the_track_says_of_its_truth_is_a_dash(made: Path) -> None:
    """The stored results need not state it, and cells that pool such a place are dashes."""
    path = made / NAME / "track.yaml"
    track = load_track(NAME, made)
    inexact = ReferencePoseError(metres=0.6, source="stated")
    first = track.places[0].model_copy(update={"reference_error": inexact})
    write_track(track.model_copy(update={"places": (first, *track.places[1:])}), made)
    assert "reference_error" in path.read_text()
    report = board(made)
    rows = {(row.start, row.season, row.part, row.method): row for row in report.rows[0]}
    for part, judged in (("all", False), (first.preset, False), ("town", True)):
        row = rows[START, "changed", part, "pixloc"]
        summary = row.summary
        assert summary.recall["5m_10deg"] is not None
        assert summary.false_fixes is not None
        figures = summary.recall["0.5m_5deg"], summary.wrong_1m, summary.worse_than_prior
        assert [figure is not None for figure in (*figures, row.surest)] == [judged] * 4
    cell = next(c for c in track_figures(report.boards[0])["starts"][0]["cells"])
    assert {pair.get("reason") for pair in cell["pairs"][1]} == {
        "the reference poses are too inexact to judge 0.5 m 5°"
    }
    assert {pair.get("reason") for pair in cell["pairs"][2]} == {None}


def test_what_is_missing_is_said_and_not_counted(
    made: Path, caplog: pytest.LogCaptureFixture
) -> None:
    results_path(made).unlink()
    for dataset in ("park-1", "town-1", "town-2"):
        (made / NAME / "results" / "none" / dataset / "sift.json").unlink()
    with caplog.at_level(logging.WARNING):
        found = read_board(NAME, made)
    assert found.missing == (
        f"no results of pixloc from start {START} on town-1",
        "no results of sift from start none on any data set",
    )
    assert [record.getMessage().partition(": ")[2] for record in caplog.records] == [*found.missing]
    assert [run.has.sum() for run in found.runs] == [72, 48, 72, 72, 72]
    rows = board(made).rows[0]
    assert {row.method for row in rows if row.start == "none"} == {"pixloc", "objconnect"}


def test_a_track_without_results_is_shown_as_such(made: Path) -> None:
    track = load_track(NAME, made)
    write_track(track.model_copy(update={"name": "new-track"}), made)
    text = board(made).text()
    assert "## new-track: Drones through the seasons\n\nNothing is measured yet." in text
    assert "- Missing: no results yet." in text


def test_tracks_with_results_come_first(made: Path) -> None:
    (track,) = (path.name for path in made.iterdir())
    empty = made / f"a-{track}"
    shutil.copytree(made / track, empty)
    shutil.rmtree(empty / "results")
    text = (empty / "track.yaml").read_text()
    (empty / "track.yaml").write_text(text.replace(f"name: {track}", f"name: a-{track}"))
    assert [board.track.name for board in read_boards(made)] == [track, f"a-{track}"]


def test_other_data_are_refused(made: Path) -> None:
    track = load_track(NAME, made)
    write_track(track.with_renders({"town-1": ("0" * 64,)}), made)
    with pytest.raises(InputError, match=r"sift\.json are of data set .* town-1 is 000000000000"):
        read_boards(made)


def test_results_from_another_start_are_refused(made: Path) -> None:
    results = load(results_path(made))
    results.model_copy(update={"start": "none"}).write(results_path(made))
    with pytest.raises(InputError, match=r"are from start none, not error=3m,5deg"):
        read_boards(made)


def test_a_query_without_a_row_is_named(made: Path) -> None:
    path = made / NAME / "queries" / "town-1.csv"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if "snow-dusk/images/000003" not in line))
    with pytest.raises(InputError, match=r"has no row for snow-dusk/images/000003.jpg"):
        read_boards(made)


def test_a_row_without_an_answer_is_named(made: Path) -> None:
    results = load(results_path(made))
    rescore(results.model_copy(update={"queries": results.queries[:-2]})).write(results_path(made))
    with pytest.raises(InputError, match=r"on town-1 lack 2 queries of .*town-1.csv"):
        read_boards(made)


def test_a_missing_list_of_queries_is_named(made: Path) -> None:
    (made / NAME / "queries" / "town-1.csv").unlink()
    with pytest.raises(InputError, match=r"town-1.csv"):
        read_boards(made)


def test_a_missing_track_or_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no track"):
        read_boards(tmp_path)
    with pytest.raises(InputError, match="is not a folder: give the folder of the tracks"):
        read_boards(tmp_path / "nowhere")


def test_the_test_board_has_all_cells(made: Path) -> None:
    found = read_board(NAME, made)
    sizes = {(cell.season, cell.part): len(cell.rows) for cell in cells(found.queries)}
    assert sizes[("changed", "all")] == 48
    assert sizes[("same", "town")] == 16
    assert sizes[("snow-dusk", "all")] == 24
