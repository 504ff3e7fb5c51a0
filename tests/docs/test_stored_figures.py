"""Figures that documents quote of stored results are those of ``benchmark/tracks``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from benchmark.report.board.runs import TrackBoard
from experiments.figure_values import p_text
from experiments.figures import documents, inserted, stale, stored_results
from objconnect.scene.errors import InputError
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
    wrong = list(stale(boards, path.read_text(encoding="utf-8")))
    assert not wrong, "python -m experiments.figures --write mends it"


@pytest.mark.parametrize("text", [SENTENCE, BLOCK, COVARIANCES])
def test_figures_are_inserted_once(text: str, boards: Boards) -> None:
    made = inserted(boards, text)
    assert "?" not in made
    assert inserted(boards, made) == made
    assert not list(stale(boards, made))


def test_another_figure_is_stale(boards: Boards) -> None:
    made = inserted(boards, SENTENCE)
    (number,) = re.findall(r">(\d+)<", made)
    wrong = made.replace(f">{number}<", f">{int(number) + 1}<")
    (line,) = stale(boards, wrong)
    assert line.startswith("line 1: ")
    assert made in line


def test_a_figure_is_that_of_the_results(boards: Boards) -> None:
    board = boards["uav-small"]
    (run,) = (run for run in board.runs if (run.start, run.method) == ("none", "sift"))
    snow = [k for k, query in enumerate(board.queries) if "snow" in query.row.condition]
    found = int(run.correct[1, snow].sum())
    text = "a <!--figure:uav-small/none/sift/snow/found--><!--end-->/"
    text += "<!--figure:uav-small/none/sift/snow/queries--><!--end-->"
    assert re.findall(r">(\d+)<", inserted(boards, text)) == [str(found), str(len(snow))]


def test_tables_of_commands_stay(boards: Boards) -> None:
    text = "<!-- figures: make demo -->\nas measured\n<!-- end -->\n"
    assert inserted(boards, text) == text


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
        ("<!-- figures: recall uav-small -->\n<!-- end -->", "recall uav-small"),
        ("<!-- figures: recall uav-small none row -->\n<!-- end -->", "no kind of row 'row'"),
    ],
)
def test_unknown_names_are_refused(text: str, message: str, boards: Boards) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        inserted(boards, text)


@pytest.mark.parametrize(
    ("p", "text"),
    [(1.0, "1"), (0.023, "0.02"), (0.0001, "0.0001"), (6.2e-14, "6e-14"), (0.0, "< 1e-300")],
)
def test_p_values_are_short(p: float, text: str) -> None:
    assert p_text(p) == text
