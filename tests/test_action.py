"""The GitHub action: its steps are run as they stand, in a repository that has nothing else."""

from __future__ import annotations

import os
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.robustness.misuse.built import ROOT, create_environment, source_tree

pytestmark = pytest.mark.thorough

ACTION: dict[str, Any] = yaml.safe_load((ROOT / "action.yml").read_text())
EXAMPLE = ROOT / "docs" / "examples" / "gate" / "localization.yml"
# Stands for GitHub's command line: it keeps what it is called with.
GH = """#!/bin/sh
printf '%s\\n' "$@" > "$GH_CALLED"
for word; do test -f "$word" && cat "$word" >> "$GH_CALLED"; done
exit 0
"""


@dataclass(frozen=True)
class Runner:
    """What GitHub's runner does with the steps that are scripts.

    Attributes:
        repository: folder of the checkout.
        environment: folder of the Python environment.
        source: folder of the action, a copy of this project.
    """

    repository: Path
    environment: Path
    source: Path

    @property
    def summary(self) -> Path:
        return self.repository.parent / "summary.md"

    @property
    def comment(self) -> Path:
        return self.repository.parent / "comment.txt"

    def run(self, event: str = "push", skip: str = "", **given: str) -> int:
        """Run the steps until one fails, then those that always run; return the exit code."""
        inputs = {name: entry.get("default", "") for name, entry in ACTION["inputs"].items()}
        assert given.keys() <= inputs.keys()
        values = {f"inputs.{name}": text for name, text in (inputs | given).items()}
        values |= {"github.event_name": event, "github.event.pull_request.number": "7"}
        failed = 0
        for step in ACTION["runs"]["steps"]:
            condition = step.get("if", "")
            if "run" not in step or step["name"] == skip or not _holds(condition, values):
                continue
            if failed and "always()" not in condition:
                continue
            env = {key: _fill(text, values) for key, text in step.get("env", {}).items()}
            failed = self._bash(step["run"], env) or failed
        return failed

    def _bash(self, script: str, env: dict[str, str]) -> int:
        path = f"{self.environment / 'bin'}{os.pathsep}{os.environ['PATH']}"
        # Without a network: what the project depends on is in the environment already.
        offline = {"PIP_NO_INDEX": "1", "PIP_NO_DEPS": "1", "PIP_NO_BUILD_ISOLATION": "0"}
        outer = {key: text for key, text in os.environ.items() if not key.startswith("PYTHON")}
        variables = {
            **{"PATH": path, "GITHUB_ACTION_PATH": str(self.source)},
            **{"GITHUB_STEP_SUMMARY": str(self.summary), "GH_CALLED": str(self.comment)},
        }
        return subprocess.run(
            ["bash", "--noprofile", "--norc", "-e", "-o", "pipefail", "-c", script],
            check=False,
            cwd=self.repository,
            env={**outer, **offline, **variables, **env},
        ).returncode


def _fill(text: str, values: dict[str, str]) -> str:
    """Replace expressions; one that is not known is left, as in the default of the token."""
    return re.sub(r"\$\{\{ (\S+) \}\}", lambda found: values.get(found[1], found[0]), str(text))


def _holds(condition: str, values: dict[str, str]) -> bool:
    """Evaluate a condition of comparisons that are joined by ``&&``."""
    for part in filter(None, condition.replace("always()", "").split("&&")):
        if found := re.fullmatch(r"\s*(\S+) == '(.*)'\s*", part):
            if values[found[1]] != found[2]:
                return False
        else:
            assert not part.strip(), condition
    return True


@pytest.fixture(scope="module")
def runner(tmp_path_factory: pytest.TempPathFactory) -> Runner:
    folder = tmp_path_factory.mktemp("action")
    (folder / "repository").mkdir()
    create_environment(folder / "venv")
    gh = folder / "venv" / "bin" / "gh"
    gh.write_text(GH)
    gh.chmod(0o755)
    runner = Runner(folder / "repository", folder / "venv", source_tree(folder / "source"))
    assert runner.run(methods="sift", install="", record="true") == 0
    assert list((runner.repository / "baseline").rglob("sift.json"))
    return runner


def test_the_same_method_passes_and_the_pull_request_has_its_table(runner: Runner) -> None:
    assert runner.run("pull_request", "Install", methods="sift") == 0
    assert "| sift | " in runner.summary.read_text()
    called = runner.comment.read_text()
    assert called.startswith("pr\ncomment\n7\n--edit-last\n")
    assert "| sift | " in called
    assert "ok   sift on gate-scene" in called


def test_a_planted_loss_fails_and_is_named_in_the_comment(runner: Runner) -> None:
    assert runner.run("pull_request", "Install", methods="sift", settings="ratio=0.2") == 1
    assert "DROP sift on gate-scene" in runner.comment.read_text()


def test_a_missing_baseline_is_an_error(runner: Runner, capfd: pytest.CaptureFixture[str]) -> None:
    assert runner.run(skip="Install", methods="sift", baseline="nothing") == 2
    assert "::error::there is no baseline nothing" in capfd.readouterr().out


def test_a_wrong_word_for_record_is_an_error(
    runner: Runner, capfd: pytest.CaptureFixture[str]
) -> None:
    assert runner.run(skip="Install", methods="sift", record="yes") == 2
    assert "::error::record is true or false, not 'yes'" in capfd.readouterr().out


def test_record_may_be_written_in_capitals_and_words_are_no_patterns(
    runner: Runner, capfd: pytest.CaptureFixture[str]
) -> None:
    (runner.repository / "sift").touch()
    assert runner.run(skip="Install", methods="sift", baseline="again", record="True") == 0
    assert list((runner.repository / "again").rglob("sift.json"))
    assert runner.run(skip="Install", methods="s[i]ft") == 2
    assert "s[i]ft" in capfd.readouterr().err


def test_an_unknown_method_is_an_error(runner: Runner, capfd: pytest.CaptureFixture[str]) -> None:
    assert runner.run(skip="Install", methods="sfit") == 2
    assert "objconnect: error: " in capfd.readouterr().err


def test_the_example_gives_inputs_that_the_action_has() -> None:
    steps = yaml.safe_load(EXAMPLE.read_text())["jobs"]["recall"]["steps"]
    (step,) = (step for step in steps if "/objconnect@" in step.get("uses", ""))
    assert set(step["with"]) <= set(ACTION["inputs"])
    required = {name for name, entry in ACTION["inputs"].items() if entry.get("required")}
    assert required <= set(step["with"])
