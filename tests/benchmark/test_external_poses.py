"""Poses made by other programs."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmark.datasets.open import open_datasets
from benchmark.results_files import load
from scene.geometry.pose import Pose
from tests.benchmark.made_data import moved, pose_at
from tests.benchmark.test_cli import error_line, invoke


def line(name: str, pose: Pose) -> str:
    numbers = [*pose.quaternion().tolist(), *pose.translation.tolist()]
    return " ".join([name, *(f"{x:.9f}" for x in numbers)]) + "\n"


def test_scored_as_our_own(made_flight: Path, tmp_path: Path) -> None:
    poses = tmp_path / "hloc.txt"
    poses.write_text(line("b.jpg", moved(pose_at(1), 0.1)) + line("d.jpg", moved(pose_at(3), 0.3)))
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


def test_last_part_of_a_name_is_enough_where_it_is_clear(scene: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(scene)
    poses = tmp_path / "poses.txt"
    poses.write_text(line("000000.jpg", pose_at(1)))
    result = invoke("score", poses, "--reference", scene, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "write whole names" in error_line(result.stderr)
    poses.write_text(line(dataset.queries[0].name, dataset.queries[0].reference))
    result = invoke("score", poses, "--reference", scene, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.stderr


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no pose"),
        ("z.jpg 1 0 0 0 0 0 0\n", "1 poses are of no query of the reference, such as z.jpg"),
        ("b.jpg 1 0 0 0 0 0\n", "expected 8 columns"),
        ("b.jpg 2 0 0 0 0 0 0\n", "quaternion"),
        ("b.jpg 1 0 0 0 0 0 nan\n", "not a finite number"),
    ],
)
def test_bad_poses(made_flight: Path, tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "poses.txt").write_text(text)
    result = invoke(
        "score", tmp_path / "poses.txt", "--reference", made_flight, "--out", tmp_path / "out"
    )
    assert result.exit_code == 2
    assert message in error_line(result.stderr)
    assert not (tmp_path / "out").exists()
