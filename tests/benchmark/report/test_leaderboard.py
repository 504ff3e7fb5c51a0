from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate
from benchmark.evaluation.starts import NONE, PRIOR, Start, parse_start
from benchmark.report.leaderboard import leaderboard
from benchmark.results.results_files import load
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Estimate, Status
from tests.benchmark.made_data import FakeLocalizer, move, pose_at


def run(data: Path, out: Path, name: str, start: Start = PRIOR, **config: Any) -> Path:
    """A method that finds every summer query 0.1 m off, and one winter query 1 m off."""
    answers = {
        f"summer-grid/images/{k:06d}.jpg": Estimate(Status.OK, move(pose_at(k + 1), 0.1))
        for k in range(3)
    }
    answers["winter-grid/images/000000.jpg"] = Estimate(Status.OK, move(pose_at(2), 1.0))
    localizer = FakeLocalizer(answers)
    localizer.name = name
    localizer.config = localizer.config.model_copy(update=config)
    (dataset,) = open_datasets(data)
    evaluate(dataset, localizer, out, start)
    return out / dataset.name / f"{name}.json"


def rows(text: str) -> list[list[str]]:
    table = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table]


def test_the_markdown_has_a_row_for_each_method(scene: Path, tmp_path: Path) -> None:
    run(scene, tmp_path / "out", "sift")
    text = leaderboard([tmp_path / "out"], tmp_path / "board")
    assert (tmp_path / "board" / "leaderboard.md").read_text() == text
    assert "## uav-sim: hamlet" in text
    assert "Start: each query's own prior. Map: summer-noon." in text
    table = rows(text)
    assert [len(row) for row in table[:5]] == [14] * 5
    assert [row[:4] for row in table[2:5]] == [
        ["sift", "all", "6", "1"],
        ["sift", "summer-noon", "3", "1"],
        ["sift", "winter-dusk", "3", "1"],
    ], "both flights are along one course"
    assert table[3][4:10] == [
        "100.0 [–]",
        "100.0 [–]",
        "100.0 [–]",
        "0.100",
        "0.000",
        "0.0 [–]",
    ]
    assert table[4][4:7] == ["0.0 [–]", "0.0 [–]", "33.3 [–]"]
    assert (table[3][12], table[4][12]) == ("0 + 0", "2 + 0")


def test_false_fixes_stand_beside_recall(scene: Path, tmp_path: Path) -> None:
    """One of six queries is answered 20 m off and called right, and one is so called a fallback."""
    name = "summer-grid/images/{:06d}.jpg".format
    answers = {
        name(0): Estimate(Status.OK, move(pose_at(1), 20)),
        name(1): Estimate(Status.FALLBACK, move(pose_at(2), 20), reason="far"),
        name(2): Estimate(Status.OK, move(pose_at(3), 4)),
    }
    (dataset,) = open_datasets(scene)
    evaluate(dataset, FakeLocalizer(answers), tmp_path / "out", PRIOR)
    text = leaderboard([tmp_path / "out"], tmp_path / "board")
    table = rows(text)
    assert [row[9] for row in table[2:5]] == [
        "16.7 [–]",
        "33.3 [–]",
        "0.0 [–]",
    ]
    assert r"16.7_{[\mbox{--}" in (tmp_path / "board" / "leaderboard.tex").read_text()


def test_wrong_answers_and_those_worse_than_the_prior_stand_beside(
    scene: Path, tmp_path: Path
) -> None:
    """Of three summer queries from 3 m one is 2 m off, one 4 m; winter's only answer is a fallback
    4 m off. Without a prior nothing is worse than it."""
    name = "summer-grid/images/{:06d}.jpg".format
    answers = {
        name(0): Estimate(Status.OK, move(pose_at(1), 2)),
        name(1): Estimate(Status.OK, move(pose_at(2), 4)),
        name(2): Estimate(Status.OK, move(pose_at(3), 0.1)),
        "winter-grid/images/000000.jpg": Estimate(
            Status.FALLBACK, move(pose_at(2), 4), reason="far"
        ),
    }
    (dataset,) = open_datasets(scene)
    for start, worse in (("error=3m,5deg", "33.3 [–]"), ("gps=5m", "0.0 [–]"), ("none", "–")):
        out = tmp_path / start
        evaluate(dataset, FakeLocalizer(answers), out, parse_start(start))
        table = rows(leaderboard([out]))
        assert table[0][9:12] == ["false fixes (%)", "> 1 m (%)", "worse than prior (%)"]
        assert table[3][9:12] == ["0.0 [–]", "66.7 [–]", worse]
        assert table[4][9:12] == ["0.0 [–]", "0.0 [–]", "–" if start == "none" else "0.0 [–]"]


def test_the_own_prior_is_what_an_answer_is_compared_with(scene: Path, tmp_path: Path) -> None:
    """The priors of this scene are wrong by some metres; an answer repeats one of them."""
    (dataset,) = open_datasets(scene)
    query = dataset.queries[0]
    assert query.prior is not None
    error = float(np.linalg.norm(query.prior.position - query.reference.centre().numpy()))
    results = evaluate(
        dataset,
        FakeLocalizer({query.name: Estimate(Status.OK, move(query.reference, error))}),
        tmp_path / "out",
    )
    assert results.queries[0].prior_t_m == pytest.approx(error)
    assert results.summary.worse_than_prior is not None
    assert results.summary.worse_than_prior.value == 0
    answers = {query.name: Estimate(Status.OK, move(query.reference, error + 0.01))}
    worse = evaluate(dataset, FakeLocalizer(answers), tmp_path / "worse")
    assert worse.by_condition[query.condition].worse_than_prior is not None
    assert worse.summary.worse_than_prior is not None
    assert worse.summary.worse_than_prior.value == pytest.approx(100 / len(dataset.queries))


def test_what_the_reference_poses_do_not_judge_is_a_dash(made_flight: Path, tmp_path: Path) -> None:
    """A dash, not 0.0 %, although a run before the error was stated had figures."""
    out = tmp_path / "out"
    run(made_flight, out, "sift")
    for metres in (0.3, 0.6, None):
        source = "unknown" if metres is None else "stated"
        stated = json.dumps({"metres": metres, "source": source})
        (made_flight / "reference_error.json").write_text(stated)
        file = run(made_flight, out, "zzz")
        text = leaderboard([out], tmp_path / "board")
        for row in rows(text)[2:4]:
            cells = [*row[4:7], *row[9:12]]
            dashes = ["–" if cell == "–" else "0" for cell in cells]
            expected = {
                0.3: ["–", "–", "0", "0", "0", "0"],
                0.6: ["–", "–", "0", "0", "–", "–"],
                None: ["–"] * 6,
            }[metres]
            assert dashes == expected
        assert load(file).summary.recall["0.25m_2deg"] is None


def test_results_without_the_newer_figures_are_read(scene: Path, tmp_path: Path) -> None:
    file = run(scene, tmp_path / "out", "sift", parse_start("error=3m,5deg"))
    text = leaderboard([file])
    stored = json.loads(file.read_text())
    for part in (stored, *(stored[f"by_{by}"] for by in ("condition", "group", "altitude"))):
        for figures in [part["summary"]] if part is stored else part.values():
            del figures["false_fixes"], figures["wrong_1m"], figures["worse_than_prior"]
    for query in stored["queries"]:
        assert query["prior_t_m"] == pytest.approx(3)
        del query["prior_t_m"]
    file.write_text(json.dumps(stored))
    assert leaderboard([file]) == text


def test_saturation_is_said_for_sift_under_the_maps_own_condition(
    scene: Path, tmp_path: Path
) -> None:
    run(scene, tmp_path / "a", "sift")
    text = leaderboard([tmp_path / "a"])
    assert "Saturated: under `summer-noon`, the map's own condition" in text
    assert "winter-dusk`, the map's own" not in text
    run(scene, tmp_path / "b", "other")
    assert "Saturated" not in leaderboard([tmp_path / "b"])


def test_starts_and_data_sets_are_not_mixed(scene: Path, made_flight: Path, tmp_path: Path) -> None:
    run(scene, tmp_path / "a", "sift")
    run(scene, tmp_path / "b", "sift", NONE)
    run(made_flight, tmp_path / "a", "sift")
    text = leaderboard([tmp_path / "a", tmp_path / "b"])
    headings = [line for line in text.splitlines() if line.startswith("## ")]
    assert headings[:-1] == ["## flight: meadow", "## uav-sim: hamlet", "## uav-sim: hamlet"]
    assert headings[-1] == "## Table I of the object-connect paper, beside ours"
    assert "Start: no prior." in text


def test_runs_of_one_method_are_told_apart(scene: Path, tmp_path: Path) -> None:
    files = [run(scene, tmp_path / str(k), "sift", strength=k) for k in (1.0, 2.0)]
    names = [row[0] for row in rows(leaderboard(files))[2:8]]
    assert names == ["sift (strength=1.0)"] * 3 + ["sift (strength=2.0)"] * 3


def test_a_file_given_twice_counts_once(scene: Path, tmp_path: Path) -> None:
    file = run(scene, tmp_path / "out", "sift")
    assert leaderboard([file, tmp_path / "out"]) == leaderboard([file])


def test_basins_are_no_results(scene: Path, tmp_path: Path) -> None:
    file = run(scene, tmp_path / "out", "sift")
    text = leaderboard([file])
    file.with_name("sift.basin.json").write_text("{}")
    assert leaderboard([tmp_path / "out"]) == text


def test_a_damaged_basin_leaves_nothing_half_written(scene: Path, tmp_path: Path) -> None:
    file = run(scene, tmp_path / "out", "sift")
    file.with_name("sift.basin.json").write_text("{}")
    with pytest.raises(InputError, match=r"missing key '.*' in .*sift\.basin\.json"):
        leaderboard([file], tmp_path / "board")
    assert not (tmp_path / "board").exists()


def test_changed_file_is_named(scene: Path, tmp_path: Path) -> None:
    file = run(scene, tmp_path / "out", "sift")
    stored = json.loads(file.read_text())
    stored["summary"]["failed"] = 0
    file.write_text(json.dumps(stored))
    with pytest.raises(InputError, match=r"sift\.json: summary\.failed does not match"):
        leaderboard([tmp_path / "out"])


def test_a_folder_without_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no results file"):
        leaderboard([tmp_path])
    with pytest.raises(InputError, match="do not exist"):
        leaderboard([tmp_path / "nowhere"])
