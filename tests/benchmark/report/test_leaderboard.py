from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate
from benchmark.evaluation.starts import NONE, PRIOR, Start
from benchmark.report.leaderboard import leaderboard
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
    assert [len(row) for row in table[:5]] == [11] * 5
    assert [row[:3] for row in table[2:5]] == [
        ["sift", "all", "6"],
        ["sift", "summer-noon", "3"],
        ["sift", "winter-dusk", "3"],
    ]
    assert table[3][3:9] == [
        "100.0 [43.9, 100.0]",
        "100.0 [43.9, 100.0]",
        "100.0 [43.9, 100.0]",
        "0.100",
        "0.000",
        "0.0 [0.0, 56.1]",
    ]
    assert table[4][3:6] == ["0.0 [0.0, 56.1]", "0.0 [0.0, 56.1]", "33.3 [6.1, 79.2]"]
    assert (table[3][9], table[4][9]) == ("0 + 0", "2 + 0")


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
    assert [row[8] for row in table[2:5]] == [
        "16.7 [3.0, 56.4]",
        "33.3 [6.1, 79.2]",
        "0.0 [0.0, 56.1]",
    ]
    assert "16.7_{[3.0" in (tmp_path / "board" / "leaderboard.tex").read_text()


def test_results_without_false_fixes_are_read(scene: Path, tmp_path: Path) -> None:
    file = run(scene, tmp_path / "out", "sift")
    text = leaderboard([file])
    stored = json.loads(file.read_text())
    for part in (stored, *(stored[f"by_{by}"] for by in ("condition", "group", "altitude"))):
        for figures in [part["summary"]] if part is stored else part.values():
            del figures["false_fixes"]
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
    with pytest.raises(InputError, match=r"sift\.json: summary\.failed does not follow"):
        leaderboard([tmp_path / "out"])


def test_a_folder_without_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no results file"):
        leaderboard([tmp_path])
    with pytest.raises(InputError, match="do not exist"):
        leaderboard([tmp_path / "nowhere"])
