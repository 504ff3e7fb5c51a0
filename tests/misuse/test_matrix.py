"""Every command with every argument spoiled in every way its kind can be: one line and exit code 2,
before the work begins, and the tree is as it was."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest

from tests.misuse import world
from tests.misuse.arguments import OPTION, UNDECODED, Fault, called
from tests.misuse.commands import COMMANDS, Row
from tests.misuse.harness import COMMAND, Begun, Outcome, differences, run, snapshot

# Of the one line, characters: what is wrong, where, and what to do.
LONGEST = 1200


@dataclass(frozen=True)
class Case:
    """A command with one fault."""

    command: str
    argument: str
    name: str
    fault: Fault

    @property
    def id(self) -> str:
        return f"{self.command}-{self.argument}-{self.name}"


def cases() -> Iterator[Case]:
    """Each argument of each command with each of its faults, and outputs that are inputs."""
    for command, row in COMMANDS.items():
        for name, argument in row.arguments.items():
            for kind, fault in argument.faults.items():
                yield Case(command, name, kind, fault)
            if argument.output and argument.faults:
                for other, source in row.arguments.items():
                    if source.reads and source.given is not None:
                        yield Case(command, name, f"is_{other}", Fault(source.reads))


CASES = list(cases())


def parameters(command: str) -> dict[str, Any]:
    """Of a command, as it declares them itself."""
    found = COMMAND.commands[command.partition(":")[0]].params
    return {parameter.name: parameter for parameter in found if parameter.name != "help"}


def words_of(command: str, row: Row, case: Case | None) -> list[str]:
    """The command line, with the fault in one argument."""
    options, plain = [command.partition(":")[0]], []
    for name, parameter in parameters(command).items():
        argument = row.arguments[name]
        given = argument.given
        if case is not None and name == case.argument:
            given = case.fault.words if case.fault.words is not None else given or argument.reads
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
    """A folder for the tree, where commands run, and beside it the system's temporary files."""
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
    """What the words of a row name, and the user's own."""
    names = {path.split("/")[0] for a in row.arguments.values() for path in a.reads}
    spoiled = (fault.at for a in row.arguments.values() for fault in a.faults.values())
    names |= {path.split("/")[0] for path in spoiled if path}
    world.copy(whole, {"mine", *(name for name in names if (whole / name).exists())}, root)


def stop_at_work(row: Row, monkeypatch: pytest.MonkeyPatch) -> None:
    """The work of a command ends the command."""

    def begin(*arguments: object, **more: object) -> None:
        raise Begun

    for work in row.work:
        monkeypatch.setattr(work, begin)


def declared(case: Case | None, row: Row, happened: Mapping[str, str]) -> set[str]:
    """What a row says that it writes, where the words of the case say that it does."""
    patterns = [*row.writes]
    for name, argument in row.arguments.items():
        undecoded = case is not None and name == case.argument and case.name == "not_utf8_name"
        for pattern in argument.writes:
            head, slash, tail = pattern.partition("/")
            patterns.append(f"{called(head, UNDECODED)}{slash}{tail}" if undecoded else pattern)
    return _like(patterns, happened)


def kept(row: Row, happened: Mapping[str, str]) -> set[str]:
    """What is of use to the next run of a row."""
    return _like([*row.keeps, *(p for a in row.arguments.values() if a.kept for p in a.writes)], happened)


def _like(patterns: Sequence[str], names: Iterable[str]) -> set[str]:
    return {name for name in names if any(fnmatchcase(name, f"tree/{p}") for p in patterns)}


def check_one_line(outcome: Outcome, says: tuple[str, ...]) -> None:
    """One line that names one of the words."""
    assert "Traceback" not in outcome.stderr, outcome.stderr
    lines = outcome.stderr.splitlines()
    assert len(lines) == 1, outcome.stderr
    assert lines[0].startswith("objconnect: error: ")
    assert lines[0].isprintable(), lines[0]
    assert len(lines[0]) <= LONGEST
    assert not says or any(word[:40] in lines[0] for word in says), (lines[0], says)
    assert outcome.stdout == ""


def names_of(case: Case) -> tuple[str, ...]:
    """What a message may call the fault."""
    parameter = parameters(case.command)[case.argument]
    itself = (*parameter.opts, parameter.name, str(parameter.metavar))
    words = [word for say in case.fault.says for word in (itself if say == OPTION else (say,))]
    return tuple(word for word in words if word.isprintable())


@pytest.mark.parametrize("case", CASES, ids=[case.id for case in CASES])
def test_misuse(case: Case, whole: Path, tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    row = COMMANDS[case.command]
    lay_out(whole, row, tree)
    if case.fault.spoil is not None:
        case.fault.spoil(tree / case.fault.at)
    stop_at_work(row, monkeypatch)
    before = snapshot(tree.parent)
    outcome = run(words_of(case.command, row, case))
    happened = differences(before, snapshot(tree.parent))
    assert Path.cwd() == tree
    if case.fault.fine:
        assert outcome.code == 0, outcome
        assert happened.keys() - declared(case, row, happened) == set()
        return
    assert not outcome.begun, "the work began"
    assert outcome.code == 2, outcome
    if row.reports and outcome.stdout:
        assert any(word in outcome.stdout for word in names_of(case)), outcome
        assert outcome.stderr == ""
    else:
        check_one_line(outcome, names_of(case))
    assert {name: happened[name] for name in happened.keys() - kept(row, happened)} == {}


@pytest.mark.parametrize("command", COMMANDS)
def test_right(command: str, whole: Path, tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a fault the same words work, or come to the work, and write what they say."""
    row = COMMANDS[command]
    lay_out(whole, row, tree)
    stop_at_work(row, monkeypatch)
    before = snapshot(tree.parent)
    outcome = run(words_of(command, row, None))
    happened = differences(before, snapshot(tree.parent))
    assert outcome.code == 0, outcome
    assert outcome.begun == bool(row.work)
    assert happened.keys() - declared(None, row, happened) == set()
