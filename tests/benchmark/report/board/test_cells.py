from __future__ import annotations

import numpy as np
import pytest

from benchmark.report.board.cells import cells, recall_at_risk
from benchmark.report.board.difficulty import AXES, bin_recall
from benchmark.report.board.runs import BoardQuery
from benchmark.results.query_result import QueryResult
from benchmark.scoring.intervals import share
from benchmark.scoring.score import THRESHOLDS
from benchmark.tracks.difficulty import Difficulty, QueryRow
from objconnect.scene.localizer import Status
from tests.benchmark.made_data import make_scored_query

AT = THRESHOLDS[1]
OVERLAP, SCALE, ANGLE, DAYS = AXES


def query(name: str, condition: str, part: str, same: bool) -> BoardQuery:
    row = QueryRow(name, condition, condition, part, Difficulty(0.5, 1.0, 5.0, 3))
    return BoardQuery(f"{part}-1", row, condition, same)


def test_cells_are_both_seasons_of_each_part_and_every_condition() -> None:
    queries = [
        query("a", "summer", "town", True),
        query("b", "snow", "town", False),
        query("c", "fog", "park", False),
        query("d", "snow", "park", False),
    ]
    found = {(cell.season, cell.part): cell.rows.tolist() for cell in cells(queries)}
    assert found == {
        ("changed", "all"): [1, 2, 3],
        ("changed", "town"): [1],
        ("changed", "park"): [2, 3],
        ("same", "all"): [0],
        ("same", "town"): [0],
        ("summer", "all"): [0],
        ("snow", "all"): [1, 3],
        ("fog", "all"): [2],
    }


def test_recall_at_risk_has_an_interval_by_course() -> None:
    believed = [answer(0.001 * k, 0.1) for k in range(40)]
    lost = [answer(None, None) for _ in range(20)]
    outcomes = [
        one.model_copy(update={"course": "abc"[k % 3]}) for k, one in enumerate([*believed, *lost])
    ]
    found = recall_at_risk(outcomes, AT)
    assert found == share([True] * 40 + [False] * 20, [one.course_name for one in outcomes])


def answer(sigma: float | None, metres: float | None, status: Status | None = None) -> QueryResult:
    return make_scored_query(
        f"{sigma}-{metres}-{id(object())}", metres, status=status, sigma_t_m=sigma
    )


def test_answers_are_accepted_until_one_in_a_hundred_is_wrong() -> None:
    right = [answer(0.001 * k, 0.1) for k in range(150)]
    wrong = answer(0.0995, 3.0)  # behind 100 right ones
    found = recall_at_risk([*right[:100], wrong], AT)
    # 1 of 101 is 0.99 %: all may be believed, but the last is none that was found.
    assert found is not None
    assert found.value == pytest.approx(100 * 100 / 101)
    # 2 of 152 are too many; the second is the last, and only those before it count.
    found = recall_at_risk([*right, wrong, answer(1.0, 3.0), answer(2.0, 0.1)], AT)
    assert found is not None
    assert found.value == pytest.approx(100 * 150 / 153)
    # One wrong answer among the first fifty: 49 of the 150 stand before it, and 1 of 151 is enough.
    found = recall_at_risk([*right, answer(0.0485, 3.0)], AT)
    assert found is not None
    assert found.value == pytest.approx(100 * 150 / 151)
    found = recall_at_risk([*right[:80], answer(0.0485, 3.0)], AT)
    assert found is not None
    assert found.value == pytest.approx(100 * 49 / 81)


def test_equal_sigmas_are_accepted_together() -> None:
    found = recall_at_risk([answer(0.1, 0.1), answer(0.2, 0.1), answer(0.2, 9.0)], AT)
    assert found is not None
    assert found.value == pytest.approx(100 / 3)


def test_an_answer_without_sigma_is_never_accepted() -> None:
    assert recall_at_risk([answer(None, 0.1), answer(None, None)], AT) is None
    lost = [answer(0.1, 0.1, Status.FALLBACK), answer(None, 0.1), answer(0.5, 0.1)]
    found = recall_at_risk(lost, AT)
    assert found is not None
    assert found.value == pytest.approx(100 / 3)


def test_bins_hold_their_lower_edge() -> None:
    assert OVERLAP.bins([0, 0.199, 0.2, 0.8, 1]).tolist() == [0, 0, 1, 4, 4]
    assert SCALE.bins([0.49, 0.5, 1, 1.41, 2, 50, None]).tolist() == [0, 1, 3, 4, 5, 5, -1]
    assert ANGLE.bins([0, 59.9, 60, 180, 181]).tolist() == [0, 4, 5, 5, -1]
    assert DAYS.bins([0, 29, 30, 182, None, float("nan"), -1]).tolist() == [0, 0, 1, 5, -1, -1, -1]
    for axis in AXES:
        assert len(axis.labels) == len(axis.edges) - 1


def test_bins_have_the_recall_of_their_queries() -> None:
    bins = np.array([0, 0, 2, -1, 2, 2, 2])
    right = np.array([True, False, True, True, True, True, False])
    courses = ["a", "b", "a", "b", "b", "c", "c"]
    first, second, third = bin_recall(bins, right, courses, 3)
    assert (first.queries, second, third.queries) == (2, (0, None), 4)
    assert first.recall is not None
    assert third.recall is not None
    assert (first.recall.value, third.recall.value) == (50, 75)
    assert first.recall == share([True, False], ["a", "b"])
    assert third.recall == share([True, True, True, False], ["a", "b", "c", "c"])
    alone = bin_recall(bins, right, ["a"] * 7, 3)[0].recall
    assert alone == (50, None, None)
