"""Submissions to a track that the repository keeps, scored without its photographs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from benchmark.report.board import command as board_command
from benchmark.report.board.runs import read_board
from benchmark.results.results_files import load
from benchmark.submissions.command import submission
from benchmark.tracks.description import TRACKS_FOLDER, load_track, write_track
from objconnect.scene.errors import InputError
from tests.benchmark.submissions.made_submission import DATASET, STORED, TRACK, write_submission

ROOT = Path(__file__).parents[3]
WORKFLOW = ROOT / ".github" / "workflows" / "submissions.yml"


@pytest.fixture
def tracks(tmp_path: Path) -> Path:
    """A copy of one track of the project."""
    shutil.copytree(TRACKS_FOLDER / TRACK, tmp_path / "benchmark" / "tracks" / TRACK)
    return tmp_path / "benchmark" / "tracks"


def test_poses_score_as_those_of_evaluate(tracks: Path) -> None:
    report = submission(write_submission(tracks / TRACK / "submissions" / "theirs"), tracks)
    stored = load(STORED)
    scores = report.as_dict()["scores"][DATASET]
    assert scores["queries"] == len(stored.queries)
    for key, recall in scores["recall"].items():
        assert recall == pytest.approx(stored.summary.recall[key].value, abs=0.01)
    before = {query.name: query for query in stored.queries}
    for query in report.results[DATASET].queries:
        if query.t_err_m is not None:
            # Micrometres of the record, tenths of a millimetre of the stored poses.
            assert query.t_err_m == pytest.approx(before[query.name].t_err_m, abs=1e-3)


def test_the_board_shows_who_submitted(tracks: Path) -> None:
    write_submission(tracks / TRACK / "submissions" / "theirs")
    board = read_board(TRACK, tracks)
    (run,) = (run for run in board.runs if run.method == "theirs")
    assert run.label == "theirs (submitted by A. Author)"
    assert run.start == "none"
    assert run.has.all()
    (ours,) = (run for run in board.runs if (run.method, run.start) == ("objconnect", "none"))
    assert (run.correct == ours.correct).all()
    assert not any("theirs" in line for line in board.missing)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"track": "uav-large"}, "no track named 'uav-large'"),
        ({"start": "gps=50m"}, "has no start 'gps=50m'"),
        ({"start": "everything"}, "everything"),
        ({"method": "objconnect"}, "the name of a method of the project"),
        ({"method": "../theirs"}, "method"),
        ({"url": "javascript:alert(1)"}, "url"),
        ({"authors": "A\nB"}, "authors"),
        ({"authors": "A) (checked by the owners"}, r"names alone.*no '\)'"),
        ({"authors": "A\u3164"}, "visible characters"),
        ({"authors": "A\u200b"}, "names alone"),
        ({"description": "A\u2800"}, "visible characters"),
        ({"datasets": {DATASET: "0" * 64}}, "is data set 000000000000, not one that the track"),
        ({"datasets": {"big-1": "0" * 64}}, "theirs: the track uav-small has no place 'big-1'"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_a_wrong_card_is_refused(tracks: Path, changed: dict[str, Any], message: str) -> None:
    folder = write_submission(tracks / TRACK / "submissions" / "theirs", **changed)
    with pytest.raises(InputError, match=message):
        submission(folder, tracks)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["nowhere.jpg 1 0 0 0 0 0 0"], "nowhere.jpg is not a query of small-1"),
        (["nowhere.jpg 1 0 0 0 nan 0 0"], "nan"),
        (["nowhere.jpg 1 0 0"], "expected 8 columns"),
        ([""], "contains no pose"),
    ],
)
def test_wrong_poses_are_refused(tracks: Path, lines: list[str], message: str) -> None:
    folder = write_submission(tracks / TRACK / "submissions" / "theirs", lines)
    with pytest.raises(InputError, match=message):
        submission(folder, tracks)


def test_names_of_people_are_accepted(tracks: Path) -> None:
    names = "É. D'Arcy-Müller, 山田 太郎, अनिल कुमार & Example Lab. 3"
    folder = write_submission(tracks / TRACK / "submissions" / "theirs", authors=names)
    submission(folder, tracks)
    (card,) = read_board(TRACK, tracks).cards
    assert card.authors == names


def test_large_files_are_refused_at_once(tracks: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read_poses(path: Path) -> None:
        raise AssertionError(f"{path} was read")

    monkeypatch.setattr("benchmark.submissions.submission.read_poses", read_poses)
    folder = write_submission(tracks / TRACK / "submissions" / "theirs")
    poses, card = folder / "poses" / f"{DATASET}.txt", folder / "card.yaml"
    line = "a/{}.jpg 1 0 0 0 0 0 0\n"
    poses.write_text("# mine\n\n" + "".join(line.format(k) for k in range(31)))
    with pytest.raises(InputError, match="has 31 poses, but small-1 has 30 queries"):
        submission(folder, tracks)
    poses.write_text(line * 200_000)
    with pytest.raises(InputError, match=r"has \d+ bytes: a file of poses of the 30 queries of"):
        submission(folder, tracks)
    card.write_text(card.read_text() + "# mine\n" * 10_000)
    with pytest.raises(InputError, match=r"card.yaml has \d+ bytes: a card has at most 65536"):
        submission(folder, tracks)


def test_a_key_that_is_given_twice_is_refused(tracks: Path) -> None:
    folder = write_submission(tracks / TRACK / "submissions" / "theirs")
    card = folder / "card.yaml"
    card.write_text(card.read_text() + "authors: B. Author\n")
    with pytest.raises(
        InputError, match=r"card.yaml is not valid YAML: the key 'authors' is given"
    ):
        submission(folder, tracks)


def test_a_broken_submission_is_named_and_left_out(tracks: Path) -> None:
    kept = tracks / TRACK / "submissions"
    write_submission(kept / "good", url="https://example.org/code", hardware="one core")
    write_submission(kept / "broken", ["a.jpg 1 0 0"], method="broken")
    write_submission(kept / "foreign", ["nowhere.jpg 1 0 0 0 0 0 0"], method="foreign")
    board = read_board(TRACK, tracks)
    assert [run.method for run in board.runs if run.authors is not None] == ["theirs"]
    left_out = [line for line in board.missing if "is left out" in line]
    assert len(left_out) == 2
    assert "the submission broken is left out: " in left_out[0]
    assert "expected 8 columns" in left_out[0]
    assert "nowhere.jpg is not a query of small-1" in left_out[1]
    submission(kept / "good", tracks)
    text = board_command.board(tracks, tracks / "out").text()
    assert "- Missing: the submission broken is left out" in text
    stated = "Trained on: nothing. Hardware: one core. https://example.org/code"
    assert stated in text
    page = (tracks / "out" / "leaderboard.html").read_text()
    assert '"hardware":"one core"' in page.replace('": "', '":"')


def test_a_missing_file_is_refused(tracks: Path) -> None:
    folder = write_submission(tracks / TRACK / "submissions" / "theirs")
    (folder / "poses" / f"{DATASET}.txt").unlink()
    with pytest.raises(InputError, match=r"lacks poses/small-1.txt, whose data set card.yaml"):
        submission(folder, tracks)


def test_other_files_and_links_are_refused(tracks: Path, tmp_path: Path) -> None:
    folder = write_submission(tracks / TRACK / "submissions" / "theirs")
    (folder / "run.py").write_text("print()")
    with pytest.raises(InputError, match=r"run.py is not a file of this submission"):
        submission(folder, tracks)
    (folder / "run.py").unlink()
    poses = folder / "poses" / f"{DATASET}.txt"
    poses.rename(tmp_path / "elsewhere.txt")
    poses.symlink_to(tmp_path / "elsewhere.txt")
    with pytest.raises(InputError, match="is a link"):
        submission(folder, tracks)


def test_duplicates_are_refused(tracks: Path) -> None:
    kept = tracks / TRACK / "submissions"
    write_submission(kept / "theirs")
    poses = kept / "theirs" / "poses" / f"{DATASET}.txt"
    backwards = poses.read_text().splitlines()[::-1]
    with pytest.raises(InputError, match="has the same poses"):
        submission(write_submission(kept / "again", backwards, method="ours"), tracks)
    shutil.rmtree(kept / "again")
    with pytest.raises(InputError, match="has results of theirs from start none"):
        submission(write_submission(kept / "again", backwards[1:]), tracks)
    shutil.rmtree(kept / "again")
    others = write_submission(kept / "again", backwards[1:], authors="B", start="error=3m,5deg")
    with pytest.raises(InputError, match=r"theirs is a method of A. Author"):
        submission(others, tracks)


def test_one_method_may_have_the_same_poses_from_two_starts(tracks: Path) -> None:
    kept = tracks / TRACK / "submissions"
    write_submission(kept / "theirs")
    write_submission(kept / "again", start="error=3m,5deg")
    runs = [run for run in read_board(TRACK, tracks).runs if run.method == "theirs"]
    assert [run.start for run in runs] == ["error=3m,5deg", "none"]


def test_results_are_of_the_render_that_the_card_names(tracks: Path) -> None:
    track = load_track(TRACK, tracks)
    other = "f" * 64
    (place,) = track.places
    write_track(track.with_renders({DATASET: (*place.renders, other)}), tracks)
    folder = write_submission(tracks / TRACK / "submissions" / "theirs", datasets={DATASET: other})
    assert submission(folder, tracks).results[DATASET].dataset.sha256 == other


def test_a_track_without_reference_poses_cannot_be_scored(tracks: Path) -> None:
    shutil.rmtree(tracks / TRACK / "renders")
    with pytest.raises(InputError, match="keeps no reference poses"):
        submission(write_submission(tracks / TRACK / "submissions" / "theirs"), tracks)


# ----------------------------------------------------------------- the workflow


def git(folder: Path, *words: str) -> str:
    identity = ["-c", "user.name=A", "-c", "user.email=a@example.org"]
    answer = subprocess.run(
        ["git", *identity, *words], cwd=folder, check=True, capture_output=True, text=True
    )
    return answer.stdout.strip()


def pull(repository: Path) -> tuple[int, str]:
    """Run the scripts of the workflow on what was changed since the first commit."""
    base = git(repository, "rev-list", "--max-parents=0", "HEAD")
    git(repository, "add", ".")
    git(repository, "commit", "-qm", "Submit")
    script = next(
        step["run"]
        for step in yaml.safe_load(WORKFLOW.read_text())["jobs"]["score"]["steps"]
        if step.get("name") == "Score"
    )
    tools = repository.parent / "tools"
    tools.mkdir(exist_ok=True)
    # The command of this checkout, on the tracks of that repository.
    command = f'#!/bin/sh\nexec {sys.executable} -m benchmark.cli "$@" --board benchmark/tracks\n'
    (tools / "objconnect").write_text(command)
    (tools / "objconnect").chmod(0o755)
    variables = {
        "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "PYTHONSAFEPATH": "1",
        "BASE": base,
        "GITHUB_STEP_SUMMARY": str(repository.parent / "summary.md"),
    }
    answer = subprocess.run(
        ["bash", "--noprofile", "--norc", "-e", "-o", "pipefail", "-c", script],
        cwd=repository,
        check=False,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
    )
    return answer.returncode, answer.stdout + answer.stderr


@pytest.mark.thorough
def test_the_workflow_ends_as_it_should(tracks: Path) -> None:
    repository = tracks.parents[1]
    kept = tracks / TRACK / "submissions"
    git(repository, "init", "-q")
    git(repository, "add", ".")
    git(repository, "commit", "-qm", "Tracks")
    base = git(repository, "rev-parse", "HEAD")

    write_submission(kept / "good")
    code, said = pull(repository)
    assert code == 0, said
    assert f"{DATASET}: " in said
    assert "30 queries" in said

    for name, lines, changed, message in (
        ("broken", ["a.jpg 1 0 0"], {}, "expected 8 columns"),
        ("foreign", None, {"datasets": {DATASET: "0" * 64}}, "not one that the track"),
        ("duplicate", None, {"method": "ours"}, "has the same poses"),
    ):
        write_submission(kept / name, lines, **changed)
        code, said = pull(repository)
        assert code == 2, (name, said)
        assert message in said
        assert "Traceback" not in said
        git(repository, "reset", "-q", "--hard", "HEAD~1")

    git(repository, "reset", "-q", "--hard", base)
    (tracks / TRACK / "track.yaml").write_text("name: mine\n")
    code, said = pull(repository)
    assert code == 2
    assert "::error::a submission changes benchmark/tracks/TRACK/submissions/" in said
