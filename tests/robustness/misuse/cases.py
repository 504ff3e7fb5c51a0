"""The cases of the matrix: each argument of each command with each of its faults."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest

from tests.robustness.misuse import world
from tests.robustness.misuse.arguments import OPTION, UNDECODED, Fault, add_to_name
from tests.robustness.misuse.commands import COMMANDS, Row
from tests.robustness.misuse.harness import COMMAND, Begun, Outcome

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


def declare(case: Case | None, row: Row, happened: Mapping[str, str]) -> set[str]:
    """What a row says that it writes, where the words of the case say that it does."""
    patterns = [*row.writes]
    for name, argument in row.arguments.items():
        undecoded = case is not None and name == case.argument and case.name == "not_utf8_name"
        for pattern in argument.writes:
            head, slash, tail = pattern.partition("/")
            patterns.append(
                f"{add_to_name(head, UNDECODED)}{slash}{tail}" if undecoded else pattern
            )
    return _like(patterns, happened)


def list_kept(row: Row, happened: Mapping[str, str]) -> set[str]:
    """What is of use to the next run of a row."""
    return _like(
        [*row.keeps, *(p for a in row.arguments.values() if a.kept for p in a.writes)], happened
    )


def _like(patterns: Sequence[str], names: Iterable[str]) -> set[str]:
    return {name for name in names if any(fnmatchcase(name, f"tree/{p}") for p in patterns)}


def check_one_line(outcome: Outcome, says: tuple[str, ...]) -> None:
    """One line that names one of the words."""
    assert "Traceback" not in outcome.stderr, outcome.stderr
    lines = outcome.stderr.splitlines()
    assert len(lines) == 1, outcome.stderr
    assert lines[0].startswith("objconnect: error: ")
    # Nothing that a terminal would obey.
    assert not {unicodedata.category(c) for c in lines[0]} & {"Cc", "Cf", "Cs", "Zl", "Zp"}
    assert len(lines[0]) <= LONGEST
    assert not says or any(word[:40] in lines[0] for word in says), (lines[0], says)
    assert outcome.stdout == ""


def names_of(case: Case) -> tuple[str, ...]:
    """What a message may call the fault."""
    parameter = parameters(case.command)[case.argument]
    itself = (*parameter.opts, parameter.name, str(parameter.metavar))
    words = [word for say in case.fault.says for word in (itself if say == OPTION else (say,))]
    return tuple(word for word in words if word.isprintable())
