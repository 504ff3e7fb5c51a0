"""The whole pipeline by the command line, from a rendered scene to a leaderboard."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmark.cli import app
from benchmark.results.results_files import load
from objconnect.scene.bundle.scene import Scene

pytestmark = pytest.mark.usefixtures("extracted_once")


@pytest.fixture(scope="module")
def results(rendered: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("results")
    command = ["evaluate", str(rendered.path), "--method", "sift", "--out", str(out)]
    answer = CliRunner().invoke(app, command)
    assert answer.exit_code == 0, answer.stderr
    assert "| sift | summer-noon | 4 |" in answer.stdout
    return out


def test_sift_localizes_its_own_season(results: Path) -> None:
    written = load(results / "hamlet" / "sift.json")
    assert written.dataset.track == "uav-sim"
    assert written.dataset.map_conditions == ("summer-noon",)
    assert written.by_condition["summer-noon"].recall["0.5m_5deg"].value == 100
    assert written.by_condition["winter-dusk"].queries == 3
    assert (results / "hamlet" / "sift-query.png").stat().st_size > 10_000


def test_sift_localizes_without_a_prior(rendered: Scene, tmp_path: Path) -> None:
    """Retrieval in the map replaces the prior; the results say so."""
    command = ["evaluate", str(rendered.path), "--method", "sift", "--start", "none", "--json"]
    answer = CliRunner().invoke(app, [*command, "--out", str(tmp_path)])
    assert answer.exit_code == 0, answer.stderr
    written = load(Path(json.loads(answer.stdout)["results"][0]))
    assert written.start == "none"
    assert written.by_condition["summer-noon"].recall["0.5m_5deg"].value == 100


def test_the_leaderboard_shows_the_results(results: Path, tmp_path: Path) -> None:
    answer = CliRunner().invoke(app, ["leaderboard", str(results), "--out", str(tmp_path)])
    assert answer.exit_code == 0, answer.stderr
    assert (tmp_path / "leaderboard.md").read_text() == answer.stdout


def test_a_scene_without_its_map_is_told_what_to_run(rendered_copy: Path, tmp_path: Path) -> None:
    for file in (rendered_copy / "map").iterdir():
        file.unlink()
    (rendered_copy / "map").rmdir()
    command = ["evaluate", str(rendered_copy), "--method", "sift", "--out", str(tmp_path / "out")]
    answer = CliRunner().invoke(app, command)
    assert answer.exit_code == 2
    assert f"run 'objconnect map {rendered_copy}'" in answer.stderr
    assert not (tmp_path / "out").exists()
