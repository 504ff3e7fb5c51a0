"""Every command with every argument spoiled in every way its kind can be: one line and exit code 2,
before the work begins, and the tree is as it was."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest

from tests.misuse import world
from tests.misuse.arguments import Argument, Fault
from tests.misuse.commands import COMMANDS, Row
from tests.misuse.harness import COMMAND, Begun, Outcome, differences, run, snapshot

# Of the one line, characters: what is wrong, where, and what to do.
LONGEST = 1200


@dataclass(frozen=True)
class Case:
    """A command with one fault."""

    command: str
    name: str
    fault: Fault

    @property
    def id(self) -> str:
        return f"{self.command}-{self.name}"


def cases() -> Iterator[Case]:
    for command, row in COMMANDS.items():
        for name, argument in row.arguments.items():
            for kind, fault in argument.faults.items():
                yield Case(command, f"{name}-{kind}", fault)
            if argument.output:
                for other, source in row.arguments.items():
                    if other != name and source.given is not None and (source.reads or source.output):
                        yield Case(command, f"{name}-is_{other}", Fault(source.given))


CASES = list(cases())


def parameters(command: str) -> dict[str, Any]:
    return {p.name: p for p in COMMAND.commands[command].params if p.name != "help"}


def words_of(command: str, row: Row, wrong: str | None, fault: Fault | None) -> list[str]:
    """The command line, with the fault in one argument."""
    options, plain = [command], []
    for name, parameter in parameters(command).items():
        given = row.arguments[name].given
        if name == wrong:
            assert fault is not None
            given = fault.words if fault.words is not None else (given or row.arguments[name].reads)
        for word in given or ():
            if parameter.param_type_name == "argument":
                plain.append(word)
            else:
                options += [parameter.opts[0], word]
    return [*options, "--", *plain]


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("whole")
    world.make(root)
    return root


@pytest.fixture
def tree(whole: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder for the tree, and beside it the system's for temporary files."""
    with tempfile.TemporaryDirectory(dir=whole.parent) as folder:
        root = Path(folder) / "tree"
        temporary = Path(folder) / "tmp"
        root.mkdir()
        temporary.mkdir()
        for variable in ("TMPDIR", "TEMP", "TMP"):
            monkeypatch.setenv(variable, str(temporary))
        monkeypatch.setattr(tempfile, "tempdir", str(temporary))
        monkeypatch.chdir(root)
        yield root


def lay_out(whole: Path, row: Row, root: Path) -> None:
    names = {path.split("/")[0] for a in row.arguments.values() for path in a.reads}
    if any("pairs" in kind for a in row.arguments.values() for kind in a.faults):
        names.add("tables")
    world.copy(whole, {"mine", *names}, root)


def stop_at_work(row: Row, monkeypatch: pytest.MonkeyPatch) -> None:
    def begin(*arguments: object, **more: object) -> None:
        raise Begun

    for work in row.work:
        monkeypatch.setattr(work, begin)


def check_refused(outcome: Outcome, fault: Fault, happened: dict[str, str]) -> None:
    assert not outcome.begun, "the work began"
    assert "Traceback" not in outcome.stderr
    assert outcome.code == 2, outcome
    lines = outcome.stderr.splitlines()
    assert len(lines) == 1, outcome.stderr
    assert lines[0].startswith("objconnect: error: ")
    assert lines[0].isprintable(), lines[0]
    assert len(lines[0]) <= LONGEST
    says = [word for word in fault.says if word.isprintable()]
    assert not says or any(word[:60] in lines[0] for word in says), (lines[0], says)
    assert outcome.stdout == ""
    assert happened == {}


@pytest.mark.parametrize("case", CASES, ids=[case.id for case in CASES])
def test_misuse(case: Case, whole: Path, tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    row = COMMANDS[case.command]
    lay_out(whole, row, tree)
    if case.fault.spoil is not None:
        case.fault.spoil(tree / case.fault.at)
    stop_at_work(row, monkeypatch)
    argument = case.name.split("-")[0]
    words = words_of(case.command, row, argument, case.fault)
    before = snapshot(tree.parent)
    outcome = run(words)
    happened = differences(before, snapshot(tree.parent))
    assert Path.cwd() == tree
    if case.fault.fine:
        assert outcome.code == 0, outcome
    else:
        check_refused(outcome, case.fault, happened)


@pytest.mark.parametrize("command", COMMANDS)
def test_right(command: str, whole: Path, tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a fault the same words work, or come to the work, and write what they say."""
    row = COMMANDS[command]
    lay_out(whole, row, tree)
    stop_at_work(row, monkeypatch)
    before = snapshot(tree.parent)
    outcome = run(words_of(command, row, None, None))
    happened = differences(before, snapshot(tree.parent))
    assert outcome.code == 0, outcome
    assert outcome.begun == bool(row.work)
    print(happened)
