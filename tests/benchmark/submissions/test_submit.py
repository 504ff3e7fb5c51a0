"""The options of ``submit`` that fit a data set, and a folder that holds poses."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from benchmark.cli import app
from benchmark.evaluation.starts import NONE, parse_start
from benchmark.submissions.answers import write_answers
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Estimate, Query, Status
from tests.benchmark.made_data import FakeLocalizer, pose_at
from tests.robustness.misuse.world import make_scene


@pytest.mark.parametrize(
    ("words", "advice"),
    [
        (["--pairs", "list.txt"], "give --start pairs=FILE"),
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


class EveryPose(FakeLocalizer):
    """Finds every query at a pose of its own."""

    def localize(self, query: Query) -> Estimate:
        self.seen.append(query)
        return Estimate(Status.OK, pose_at(int(Path(query.name).stem)))


def write_poses(hamlet: Path, out: Path, localizer: FakeLocalizer, **options: Any) -> bytes:
    """Write the poses of a scene, and return the file."""
    report = write_answers(hamlet, localizer, out, options.pop("start", NONE), **options)
    return report.files["hamlet"].read_bytes()


def test_jobs_are_queries_at_a_time_and_change_no_byte(tmp_path: Path) -> None:
    hamlet = make_scene(tmp_path / "hamlet")
    met = threading.Barrier(2, timeout=20)

    class Pairwise(EveryPose):
        def localize(self, query: Query) -> Estimate:
            met.wait()
            return super().localize(query)

    one = write_poses(hamlet, tmp_path / "one", EveryPose({}))
    assert write_poses(hamlet, tmp_path / "two", Pairwise({}), jobs=2) == one


def test_the_same_command_keeps_finished_poses(tmp_path: Path) -> None:
    hamlet = make_scene(tmp_path / "hamlet")
    written = write_poses(hamlet, tmp_path / "out", EveryPose({}))
    again = EveryPose({})
    assert write_poses(hamlet, tmp_path / "out", again) == written
    assert not again.seen


@pytest.mark.parametrize("finished", [True, False])
@pytest.mark.parametrize("other", ["start", "option", "method"])
def test_poses_of_another_run_are_not_replaced(finished: bool, other: str, tmp_path: Path) -> None:
    hamlet, out = make_scene(tmp_path / "hamlet"), tmp_path / "out"
    if finished:
        write_poses(hamlet, out, EveryPose({}))
    else:

        class Interrupted(EveryPose):
            def localize(self, query: Query) -> Estimate:
                if self.seen:
                    raise KeyboardInterrupt
                return super().localize(query)

        with pytest.raises(KeyboardInterrupt):
            write_poses(hamlet, out, Interrupted({}))
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    localizer, start = EveryPose({}), NONE
    if other == "start":
        start = parse_start("error=3m,5deg")
    elif other == "option":
        localizer.config = localizer.config.model_copy(update={"strength": 2.0})
    else:
        localizer.name = "other"
    with pytest.raises(InputError, match="holds poses of fake, start none, .*: choose another"):
        write_poses(hamlet, out, localizer, start=start)
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    assert not localizer.seen


def test_the_command_refuses_another_start_in_one_line(tmp_path: Path) -> None:
    hamlet, out = make_scene(tmp_path / "hamlet"), tmp_path / "out"
    words = ["submit", str(hamlet), "--method", "prior", "--out", str(out), "--start"]
    assert CliRunner().invoke(app, [*words, "prior"]).exit_code == 0
    written = (out / "poses" / "hamlet.txt").read_bytes()
    result = CliRunner().invoke(app, [*words, "none"])
    assert result.exit_code == 2
    (line,) = result.output.strip().splitlines()
    assert "holds poses of prior, start prior, " in line and "choose another --out" in line
    assert (out / "poses" / "hamlet.txt").read_bytes() == written
    assert CliRunner().invoke(app, [*words, "prior"]).exit_code == 0
