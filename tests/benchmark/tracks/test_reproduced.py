from __future__ import annotations

from pathlib import Path

import pytest

from benchmark.datasets.open import open_datasets
from benchmark.evaluate import evaluate
from benchmark.registry import create
from benchmark.report.board.runs import read_board
from benchmark.results import QueryResult
from benchmark.score import THRESHOLDS, is_correct
from benchmark.starts import parse_start
from benchmark.tracks.command import track
from benchmark.tracks.description import BOARD

NAME = "uav-small"


def verdicts(query: QueryResult) -> list[bool]:
    return [is_correct(query, threshold) for threshold in THRESHOLDS]


@pytest.mark.thorough
def test_a_fresh_render_gives_the_recorded_results(tmp_path: Path) -> None:
    """On any processor: the render is that of the leaderboard but for rounding, and so are answers.

    Rounding may move the answer to a query across a threshold, but hardly ever.
    """
    report = track(NAME, tmp_path / "scenes")
    assert report.differing == (), report.text()
    (dataset,) = open_datasets(report.places[0].scene)
    board = read_board(NAME, BOARD)
    assert {(run.start, run.method) for run in board.runs} == {
        (start, method) for start in board.track.starts for method in board.track.methods
    }
    for run in board.runs:
        fresh = evaluate(
            dataset,
            create(run.method, {}),
            tmp_path / run.start,
            parse_start(run.start),
            tmp_path / "cache",
        )
        recorded = {answer.name: answer for answer in run.answers if answer is not None}
        assert recorded.keys() == {query.name for query in fresh.queries}
        moved = [q.name for q in fresh.queries if verdicts(q) != verdicts(recorded[q.name])]
        assert len(moved) <= 2, (run.start, run.method, moved)
