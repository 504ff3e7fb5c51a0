"""How many modules a reader follows from ``objconnect localize`` to the descent of an alignment."""

from __future__ import annotations

import re
import shutil
import traceback
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from benchmark.cli import app
from benchmark.gate.scene import GATE_SCENES
from objconnect.localization.align import aligner
from objconnect.localization.align.descent import descend

ROOT = Path(__file__).parents[4]
GATE = GATE_SCENES["gate-snow"]
NAME = "same/images/000000.jpg"
COMMAND = "benchmark/cli/localization.py"
MOST = 9
PACKAGES = ("objconnect", "simulate", "baselines", "benchmark")


def write() -> list[str]:
    """The path as CONTRIBUTING.md lists it."""
    _, _, text = (ROOT / "CONTRIBUTING.md").read_text().partition("## From a photograph to a pose")
    section = text.partition("\n## ")[0]
    return re.findall(r"^\d+\. `([\w/.]+)`", section, re.MULTILINE)


def test_the_path_is_short_and_its_modules_exist() -> None:
    assert 0 < len(write()) <= MOST
    assert all((ROOT / module).is_file() for module in write())


@pytest.mark.thorough
@pytest.mark.parametrize("is_told", [True, False])
def test_a_photograph_takes_the_path_that_is_written(
    is_told: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stacks: set[tuple[str, ...]] = set()

    def record_call(*given: Any) -> Any:
        files = [Path(frame.filename) for frame in traceback.extract_stack()[:-1]]
        # An environment that lies in the same folder is not part of what a reader follows.
        below = [file.relative_to(ROOT) for file in files if file.is_relative_to(ROOT)]
        ours = [str(file) for file in below if file.parts[0] in PACKAGES]
        modules = [module for module, _ in groupby(ours)]
        stacks.add(tuple(modules[modules.index(COMMAND) :]))
        return descend(*given)

    monkeypatch.setattr(aligner, "descend", record_call)
    (tmp_path / "new").mkdir()
    shutil.copy(GATE / "images" / NAME, tmp_path / "new" / "a.jpg")
    header, *priors = (GATE / "priors.csv").read_text().splitlines()
    (prior,) = (line for line in priors if line.startswith(NAME))
    (tmp_path / "priors.csv").write_text(f"{header}\n{prior.replace(NAME, 'a.jpg')}\n")
    (query,) = (q for q in (GATE / "queries.txt").read_text().splitlines() if q.startswith(NAME))
    words = ["localize", "--map", GATE, "--images", tmp_path / "new", "--out", tmp_path / "a.txt"]
    words += ["--camera", query.partition(" ")[2], "--set", "matches=null"]
    words += ["--priors", tmp_path / "priors.csv"] if is_told else []
    answer = CliRunner().invoke(app, [*map(str, words)])
    assert answer.exit_code == 0 and "1 of 1 photographs found" in answer.stdout, answer.output
    # What tells whether a pose is right aligns it to halves of the points once more.
    to_a_pose = {stack for stack in stacks if not any("evidence" in module for module in stack)}
    longest = max(to_a_pose, key=len)
    searched = "objconnect/localization/featuremetric/global_search.py"
    expected = [module for module in write() if not is_told or module != searched]
    assert [*longest, "objconnect/localization/align/descent.py"] == expected
