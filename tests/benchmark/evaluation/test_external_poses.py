"""Poses made by other programs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.datasets.open import open_datasets
from benchmark.report import tables
from benchmark.report.paper import side_by_side
from benchmark.results.results_files import load
from objconnect.scene.geometry.pose import Pose
from tests.benchmark.made_data import move, pose_at
from tests.benchmark.test_cli import error_line, invoke


def line(name: str, pose: Pose) -> str:
    numbers = [*pose.quaternion().tolist(), *pose.translation.tolist()]
    return " ".join([name, *(f"{x:.9f}" for x in numbers)]) + "\n"


def test_external_poses_are_scored_like_our_own(made_flight: Path, tmp_path: Path) -> None:
    poses = tmp_path / "hloc.txt"
    poses.write_text(line("b.jpg", move(pose_at(1), 0.1)) + line("d.jpg", move(pose_at(3), 0.3)))
    arguments = ("score", poses, "--reference", made_flight, "--out", tmp_path / "out")
    result = invoke(*arguments, "--start", "retrieval=50")
    assert result.exit_code == 0, result.stderr
    results = load(tmp_path / "out/meadow/hloc.json")
    assert (results.method.name, results.start) == ("hloc", "retrieval=50")
    assert [query.t_err_m for query in results.queries] == [
        pytest.approx(0.1, abs=1e-6),
        pytest.approx(0.3, abs=1e-6),
        None,
    ]
    assert results.summary.failed == 1
    assert results.summary.recall["0.25m_2deg"].value == pytest.approx(100 / 3)
    assert "hloc" in result.stdout


def test_the_last_part_of_a_name_is_enough_if_unique(scene: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(scene)
    poses = tmp_path / "poses.txt"
    poses.write_text(line("000000.jpg", pose_at(1)))
    result = invoke("score", poses, "--reference", scene, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "write the full names" in error_line(result.stderr)
    poses.write_text(line(dataset.queries[0].name, dataset.queries[0].reference))
    result = invoke("score", poses, "--reference", scene, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.stderr


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "contains no pose"),
        ("z.jpg 1 0 0 0 0 0 0\n", "1 poses belong to no query of the data sets, such as z.jpg"),
        ("b.jpg 1 0 0 0 0 0\n", "expected 8 columns"),
        ("b.jpg 2 0 0 0 0 0 0\n", "quaternion"),
        ("b.jpg 1 0 0 0 0 0 nan\n", "not a finite number"),
    ],
)
def test_bad_files_of_poses_are_refused(
    made_flight: Path, tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "poses.txt").write_text(text)
    result = invoke(
        "score", tmp_path / "poses.txt", "--reference", made_flight, "--out", tmp_path / "out"
    )
    assert result.exit_code == 2
    assert message in error_line(result.stderr)
    assert not (tmp_path / "out").exists()


def test_the_start_is_as_declared(made_flight: Path, tmp_path: Path) -> None:
    """Beside a method that was told it by us; nobody can mistake one for the other."""
    out = tmp_path / "out"
    poses = tmp_path / "hloc.txt"
    poses.write_text(line("b.jpg", pose_at(1)))
    words = ("--out", out, "--start", "none")
    assert invoke("evaluate", made_flight, "--method", "sift", *words).exit_code == 0
    result = invoke("score", poses, "--reference", made_flight, *words)
    assert "Start: no prior (as declared, not verified, for hloc)." in result.stdout
    board = tmp_path / "board"
    printed = invoke("leaderboard", out, "--out", board)
    assert "Start: no prior (as declared, not verified, for hloc)." in printed.stdout
    for name in ("leaderboard.md", "leaderboard.tex", "leaderboard.html"):
        assert "as declared, not verified, for hloc" in (board / name).read_text(), name
    (table,) = json.loads(invoke("leaderboard", out, "--json").stdout)["tables"]
    assert table["declared"] == ["hloc"]


def test_our_own_start_is_not_declared(made_flight: Path, tmp_path: Path) -> None:
    words = ("--out", tmp_path / "out", "--start", "none")
    result = invoke("evaluate", made_flight, "--method", "sift", *words)
    assert "as declared" not in result.stdout


def test_the_papers_table_says_as_declared(made_flight: Path, tmp_path: Path) -> None:
    poses = tmp_path / "hloc.txt"
    poses.write_text(line("b.jpg", pose_at(1)))
    invoke("score", poses, "--reference", made_flight, "--out", tmp_path / "out")
    groups = [replace(group, track="uav-sim") for group in tables.groups([tmp_path / "out"])]
    (ours,) = [line for line in side_by_side(groups) if not line.reported]
    assert ours.source == "measured here, start as declared: no prior"
