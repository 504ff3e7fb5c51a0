from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmark.results.results import DatasetId, Results, rescore
from benchmark.results.results_files import load
from objconnect.localization.provenance import Method
from objconnect.scene.errors import InputError
from tests.benchmark.made_data import make_scored_query


@pytest.fixture
def results() -> Results:
    queries = (
        make_scored_query("a", 0.1, course="one"),
        make_scored_query("b", 0.7, course="two"),
        make_scored_query("c", None, "winter", course="one"),
    )
    return Results.of(
        Method(name="fake", config={"strength": 1.0}, weights_sha256=None),
        DatasetId(name="meadow", track="flight", sha256="ab", map_conditions=("summer",)),
        "prior",
        queries,
        1.5,
        300.0,
    )


def test_results_survive_writing_and_reading(results: Results, tmp_path: Path) -> None:
    path = tmp_path / "fake.json"
    results.write(path)
    assert load(path) == results
    assert rescore(results) == results


def test_the_file_has_its_documented_layout(results: Results, tmp_path: Path) -> None:
    results.write(tmp_path / "fake.json")
    stored = json.loads((tmp_path / "fake.json").read_text())
    assert stored["schema"] == 1
    assert set(stored["environment"]) == {"objconnect", "python", "numpy", "torch", "pycolmap"}
    assert set(stored["summary"]["recall"]) == {"0.25m_2deg", "0.5m_5deg", "5m_10deg"}
    assert set(stored["summary"]["recall"]["5m_10deg"]) == {"value", "low", "high"}
    assert stored["summary"]["seconds"] == {"prepare": 1.5, "per_query": {"total": 0.25}}
    assert set(stored["by_condition"]) == {"summer", "winter"}
    assert stored["queries"][2]["t_err_m"] is None
    assert stored["queries"][0]["cam_from_world"] == [1, 0, 0, 0, 0, 0, 0]


def test_intervals_of_earlier_files_are_replaced(results: Results, tmp_path: Path) -> None:
    """Files without courses have intervals of independent queries."""
    path = tmp_path / "fake.json"
    results.write(path)
    stored = json.loads(path.read_text())
    for query in stored["queries"]:
        del query["course"]
    parts = (stored[f"by_{by}"].values() for by in ("condition", "group", "altitude"))
    for figures in (stored["summary"], *(figures for part in parts for figures in part)):
        del figures["courses"]
    stored["summary"]["recall"]["5m_10deg"] |= {"low": 20.8, "high": 93.9}
    path.write_text(json.dumps(stored))
    found = load(path)
    # All queries are of one group, which counts as one course.
    assert found.summary.courses == 1
    assert found.summary.recall["5m_10deg"].text() == "66.7 [–]"
    assert results.summary.courses == 2
    assert results.summary.recall["5m_10deg"].low is not None
    stored["summary"]["recall"]["5m_10deg"]["value"] += 1
    path.write_text(json.dumps(stored))
    with pytest.raises(InputError, match="summary.recall.5m_10deg.value does not match"):
        load(path)


def test_a_condition_without_poses_has_no_median(results: Results) -> None:
    assert results.by_condition["winter"].median_t_m is None


def _recall(stored: dict[str, Any]) -> None:
    stored["summary"]["recall"]["0.25m_2deg"]["value"] = 99.0


def _interval(stored: dict[str, Any]) -> None:
    stored["by_condition"]["summer"]["recall"]["5m_10deg"]["low"] += 0.01


def _condition(stored: dict[str, Any]) -> None:
    del stored["by_condition"]["winter"]


def _error(stored: dict[str, Any]) -> None:
    stored["queries"][1]["t_err_m"] = 0.1


def _drop(stored: dict[str, Any]) -> None:
    del stored["queries"][2]


@pytest.mark.parametrize(
    ("tamper", "where"),
    [
        (_recall, "summary.recall.0.25m_2deg.value"),
        (_interval, "by_condition.summer.recall.5m_10deg.low"),
        (_condition, "by_condition.winter"),
        (_error, "summary.median_t_m"),
        (_drop, "summary.failed"),
    ],
)
def test_changed_figures_are_noticed(
    results: Results, tmp_path: Path, tamper: Callable[[dict[str, Any]], None], where: str
) -> None:
    path = tmp_path / "fake.json"
    results.write(path)
    stored = json.loads(path.read_text())
    tamper(stored)
    path.write_text(json.dumps(stored))
    with pytest.raises(InputError) as caught:
        load(path)
    assert str(path) in str(caught.value)
    assert where in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"schema": 1', '"schema": 2', "schema"),
        ('"start": "prior"', '"start": "luck"', "start"),
        ('"start": "prior"', '"start": "prior", "comment": 1', "unknown key 'comment'"),
        ('"t_err_m": 0.1', '"t_err_m": NaN', "queries.0.t_err_m"),
        ('"t_err_m": 0.1', '"t_err_m": -0.1', "queries.0.t_err_m"),
        ('"t_err_m": 0.1', '"t_err_m": null', "contradicts its pose and errors"),
        ('"status": "failed"', '"status": "fallback"', "contradicts its pose and errors"),
        ('"name": "b"', '"name": "a"', "query a is listed twice"),
        ('"schema"', "schema", "is not valid JSON"),
    ],
)
def test_damaged_files_are_refused(
    results: Results, tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = tmp_path / "fake.json"
    results.write(path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
