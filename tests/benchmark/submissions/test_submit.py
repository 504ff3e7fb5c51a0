"""The options of ``submit`` that fit a data set."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmark.cli import app
from tests.robustness.misuse.world import make_scene


@pytest.mark.parametrize(
    ("words", "advice"),
    [
        (["--pairs", "list.txt"], "give --start pairs=FILE"),
        (["--jobs", "2"], "leave it out"),
        (["--dry-run"], "leave it out"),
    ],
)
def test_options_of_cmu_seasons_are_refused(words: list[str], advice: str, tmp_path: Path) -> None:
    hamlet = make_scene(tmp_path / "hamlet")
    arguments = ["submit", str(hamlet), "--out", str(tmp_path / "out"), *words]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert f"{words[0]} is for Extended CMU Seasons, and {hamlet} is not: {advice}" in result.output
    assert len(result.output.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
