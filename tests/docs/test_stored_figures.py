"""Figures that documents quote of stored results are those of ``benchmark/tracks``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from benchmark.report.board.runs import TrackBoard, read_board
from benchmark.scoring.score import recall
from benchmark.tracks.description import load_track, write_track
from experiments.figure_tables import table
from experiments.figure_values import FOUND, p_text, select, value
from experiments.figures import documents, insert_figures, list_stale, stored_results
from objconnect.scene.bundle.held_out import HeldOut
from objconnect.scene.errors import InputError
from tests.benchmark.report.board.made_board import write_board
from tests.docs.documents import name

Boards = Mapping[str, TrackBoard]

SENTENCE = "It finds <!--figure:uav-small/none/sift/changed/found-->?<!--end--> of them."
BLOCK = "<!-- figures: recall uav-small none part -->\n?\n<!-- end -->\n"
COVARIANCES = "<!-- figures: covariances uav-small objconnect -->\n?\n<!-- end -->\n"


@pytest.fixture(scope="module")
def boards() -> Boards:
    return stored_results()


@pytest.mark.parametrize("path", documents(), ids=name)
def test_documents_state_the_stored_results(path: Path, boards: Boards) -> None:
    wrong = list(list_stale(boards, path.read_text(encoding="utf-8")))
    assert not wrong, "python -m experiments.figures --write mends it"


@pytest.mark.parametrize("text", [SENTENCE, BLOCK, COVARIANCES])
def test_figures_are_inserted_once(text: str, boards: Boards) -> None:
    made = insert_figures(boards, text)
    assert "?" not in made
    assert insert_figures(boards, made) == made
    assert not list(list_stale(boards, made))


def test_another_figure_is_stale(boards: Boards) -> None:
    made = insert_figures(boards, SENTENCE)
    (number,) = re.findall(r">(\d+)<", made)
    wrong = made.replace(f">{number}<", f">{int(number) + 1}<")
    (line,) = list_stale(boards, wrong)
    assert line.startswith("line 1: ")
    assert made in line


def test_a_figure_is_that_of_the_results(boards: Boards) -> None:
    board = boards["uav-small"]
    (run,) = (run for run in board.runs if (run.start, run.method) == ("none", "sift"))
    snow = [k for k, query in enumerate(board.queries) if "snow" in query.row.condition]
    found = int(run.correct[1, snow].sum())
    text = "a <!--figure:uav-small/none/sift/snow/found--><!--end-->/"
    text += "<!--figure:uav-small/none/sift/snow/queries--><!--end-->"
    assert re.findall(r">(\d+)<", insert_figures(boards, text)) == [str(found), str(len(snow))]


def test_tables_of_commands_stay(boards: Boards) -> None:
    text = "<!-- figures: make demo -->\nas measured\n<!-- end -->\n"
    assert insert_figures(boards, text) == text


def test_seen_and_unseen_are_compared_on_the_same_places(tmp_path: Path) -> None:
    folder = write_board(tmp_path)
    held = HeldOut(conditions=("snow",), presets=("park",))
    track = load_track("uav-seasons", folder)
    write_track(track.model_copy(update={"held_out": held}), folder)
    (folder / "uav-seasons" / "results" / "none" / "town-2" / "pixloc.json").unlink()
    boards = {"uav-seasons": read_board("uav-seasons", folder)}
    rows = table(boards, "novelty uav-seasons none").splitlines()[2:]
    assert [row.split("|")[1].strip() for row in rows] == [
        "seen (1 place, 8, 1 course)",
        "unseen condition (1 place, 8, 1 course)",
        "unseen place (1 place, 8, 1 course)",
        "unseen both (1 place, 8, 1 course)",
    ]
    chosen = table(boards, "novelty uav-seasons none sift objconnect").splitlines()
    assert chosen[0] == "|  | `sift` | `objconnect` |"
    assert chosen[2].startswith("| seen (2 places, 16, 2 courses) |")
    cell = "uav-seasons/none/objconnect/unseen-condition"
    assert value(boards, f"{cell}/places") == "2"
    assert f" {value(boards, cell).removesuffix(' %')} [" in chosen[3].split("|")[3]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a <!--figure:uav-small/none/sift--><!--end-->", "is not TRACK/START/METHOD/QUERIES"),
        ("a <!--figure:uav-large/none/sift/all--><!--end-->", "no track 'uav-large'"),
        ("a <!--figure:uav-small/none/orb/all--><!--end-->", "none/orb"),
        ("a <!--figure:uav-small/none/sift/rain--><!--end-->", "no queries 'rain'"),
        ("a <!--figure:uav-small/none/sift/same+snow--><!--end-->", "no query that is same+snow"),
        ("a <!--figure:uav-small/none/sift/all/luck--><!--end-->", "no figure 'luck'"),
        ("a <!--figure:uav-small/none/sift/all/won=orb--><!--end-->", "none/orb"),
        ("a <!--figure:uav-small/none/sift/all/luck=sift--><!--end-->", "paired figure 'luck'"),
        ("<!--figure:uav-small/none/sift/all--><!--end-->", "begins a line"),
        ("<!-- figures: tables -->\n<!-- end -->", "no table 'tables'"),
        ("<!-- figures: novelty uav-small none -->\n<!-- end -->", "holds out nothing"),
        ("<!-- figures: recall uav-small -->\n<!-- end -->", "recall uav-small"),
        ("<!-- figures: recall uav-small none row -->\n<!-- end -->", "no kind of row 'row'"),
    ],
)
def test_unknown_names_are_refused(text: str, message: str, boards: Boards) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        insert_figures(boards, text)


@pytest.mark.parametrize(
    ("p", "text"),
    [(1.0, "1"), (0.023, "0.02"), (0.0001, "0.0001"), (6.2e-14, "6e-14"), (0.0, "< 1e-300")],
)
def test_p_values_are_short(p: float, text: str) -> None:
    assert p_text(p) == text


def test_intervals_are_by_course(boards: Boards) -> None:
    """A bootstrap of whole courses gives [96.1, 99.6], independent queries [97.5, 98.5]."""
    board = boards["uav-seasons"]
    cell = "uav-seasons/error=3m,5deg/objconnect/changed"
    assert value(boards, f"{cell}/courses") == "14"
    (run,) = (r for r in board.runs if (r.start, r.method) == ("error=3m,5deg", "objconnect"))
    found = recall(run.answers_at(select(board, "changed")), FOUND)
    assert found.low == pytest.approx(96.1, abs=1.5)
    assert found.high == pytest.approx(99.6, abs=0.5)
    assert value(boards, f"{cell}/interval") == f"98.1 % [{found.low:.1f}, {found.high:.1f}]"
