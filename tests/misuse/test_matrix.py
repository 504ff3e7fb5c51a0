"""Every command with every argument spoiled in every way its kind can be: one line and exit code 2,
before the work begins, and the tree is as it was."""

from __future__ import annotations

import shutil
import tempfile
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from benchmark.boundary import REGRESSION
from tests.fuzz.readers import READERS
from tests.misuse import world
from tests.misuse.arguments import OPTION, UNDECODED, Fault, called
from tests.misuse.commands import COMMANDS, READ, Row
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


# Words that contradict each other, or are none of a command's: command, what is given, what the
# error names.
CONTRADICTIONS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "two_of_one_name": (
        ("evaluate", "hamlet", "copy/hamlet", "--method", "sift", "--out", "out"),
        ("hamlet",),
    ),
    "basin_of_two_of_one_name": (
        ("basin", "meadow", "copy/meadow", "--method", "sift", "--out", "out"),
        ("meadow",),
    ),
    "second_data_set_is_none": (
        ("evaluate", "hamlet", "mine", "--method", "sift", "--out", "out"),
        ("mine",),
    ),
    "second_method_is_none": (
        ("evaluate", "hamlet", "--method", "sift", "--method", "magic", "--out", "out"),
        ("magic",),
    ),
    "remove_and_weights": (
        ("supplement", "hamlet", "--remove", "--weights", "weights/net.safetensors"),
        ("--remove",),
    ),
    "remove_and_masks": (
        ("supplement", "hamlet", "--remove", "--masks", "masks/coco.json"),
        ("--remove",),
    ),
    "poses_named_as_their_table": (
        ("localize", "--map", "meadow", "--images", "photos", "--out", "out.csv"),
        ("out.csv",),
    ),
    "table_is_the_priors": (
        ("localize", "--map", "meadow", "--images", "photos", "--priors", "tables/priors.csv",
         "--out", "tables/priors.txt"),
        ("priors.csv",),
    ),
    "poses_among_the_photographs": (
        ("localize", "--map", "meadow", "--images", "photos", "--out", "photos/p0.jpg"),
        ("p0.jpg",),
    ),
    "page_is_the_manifest": (("view", "hamlet", "--out", "hamlet/scene.json"), ("scene.json",)),
    "page_is_its_picture": (("view", "hamlet", "--out", "out.png"), ("out.png",)),
    "page_over_a_note": (("view", "hamlet", "--out", "mine/notes.txt"), ("notes.txt",)),
    "results_of_another_scene": (
        ("view", "hamlet", "--results", "results/meadow"),
        ("meadow",),
    ),
    "export_into_the_scene": (
        ("export", "hamlet", "--format", "tum", "--out", "hamlet/tum"),
        ("hamlet/tum",),
    ),
    "export_over_a_note": (("export", "hamlet", "--format", "tum", "--out", "mine"), ("mine",)),
    "simulate_over_a_note": (("simulate", "--out", "mine"), ("mine",)),
    "ingest_over_a_note": (("ingest", "photos", "--out", "mine"), ("mine",)),
    "ingest_into_the_photographs": (("ingest", "photos", "--out", "photos/scene"), ("photos",)),
    "scene_of_another_configuration": (("simulate", "--out", "hamlet"), ("hamlet",)),
    "ingest_into_another_scene": (("ingest", "photos", "--out", "hamlet"), ("hamlet",)),
    "baseline_of_nothing": (("regress", "results", "--against", "mine"), ("mine",)),
    "baseline_is_the_results": (
        ("regress", "results", "--against", "results", "--update"),
        ("results",),
    ),
    "leaderboard_of_nothing": (("leaderboard", "mine"), ("mine",)),
    "score_replaces_an_evaluation": (
        ("score", "tables/poses.txt", "--reference", "meadow", "--method", "sift", "--out",
         "results"),
        ("sift.json",),
    ),
    "poses_are_a_picture": (
        ("score", "photos/p0.jpg", "--reference", "meadow", "--out", "out"),
        ("p0.jpg",),
    ),
    "photographs_are_a_scene": (("ingest", "mine", "--out", "out"), ("mine",)),
    "map_of_a_flight": (("map", "meadow"), ("meadow",)),
    "dense_of_a_flight": (("dense", "meadow"), ("meadow",)),
    "train_on_a_flight": (
        ("train", "objconnect", "--data", "meadow", "--out", "out"),
        ("meadow",),
    ),
    "submit_a_scene": (("submit", "hamlet", "--out", "out"), ("hamlet",)),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_contradiction(name: str, whole: Path, tree: Path) -> None:
    words, says = CONTRADICTIONS[name]
    folders = {entry.name for entry in whole.iterdir()}
    world.copy(whole, folders, tree)
    world.copy(whole, {"hamlet", "meadow"}, tree / "copy")
    check_refused(words, says, tree)


def usage() -> Iterator[tuple[str, ...]]:
    """Command lines that are none."""
    for command in COMMAND.commands:
        arguments = parameters(command).values()
        yield command, "--colour", "red"
        if any(parameter.required for parameter in arguments):
            yield (command,)
        yield command, *("stray",) * 9, *(("--",) if command == "doctor" else ("--colour",))
        for parameter in arguments:
            if parameter.param_type_name == "option" and not parameter.is_flag:
                yield command, parameter.opts[0]
    yield ("magic",)
    yield ("--colour",)
    yield ("",)


@pytest.mark.parametrize("words", list(usage()), ids=" ".join)
def test_usage(words: tuple[str, ...], tree: Path) -> None:
    check_refused(words, (), tree)


def check_refused(words: Sequence[str], says: tuple[str, ...], tree: Path) -> None:
    """One line, exit code 2, and nothing else."""
    before = snapshot(tree.parent)
    outcome = run(words)
    assert outcome.code == 2, outcome
    check_one_line(outcome, says)
    assert differences(before, snapshot(tree.parent)) == {}


# Commands that end at once whatever they are given.
QUICK = ("score", "leaderboard", "regress", "export", "train", "calibrate", "gallery", "ingest")


@given(st.data())
@settings(
    max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
def test_any_words(whole: Path, tree: Path, data: st.DataObject) -> None:
    """One argument is whatever it is: the command works, or says in one line why not."""
    command = data.draw(st.sampled_from(QUICK))
    row = COMMANDS[command]
    argument = data.draw(st.sampled_from([n for n, a in row.arguments.items() if a.given]))
    # A name with a slash may be a place outside the tree.
    text = st.text(st.characters(blacklist_characters="/", codec=None), max_size=40)
    number = st.one_of(st.integers(), st.floats()).map(str)
    fault = Fault((data.draw(st.one_of(text, number)),))
    root = tree / "one"
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir()
    lay_out(whole, row, root)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        stop_at_work(row, patch)
        before = snapshot(root)
        outcome = run(words_of(command, row, Case(command, argument, "any", fault)))
        happened = differences(before, snapshot(root))
    if outcome.code:
        assert outcome.code == 2, outcome
        check_one_line(outcome, ())
        assert happened == {}
    else:
        assert set(happened.values()) <= {"new"}
        assert "Traceback" not in outcome.stderr


@given(st.data())
@settings(
    max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
def test_any_bytes(whole: Path, tree: Path, data: st.DataObject) -> None:
    """One file has whatever bytes in its middle."""
    command = data.draw(st.sampled_from(QUICK))
    row = COMMANDS[command]
    spoiled = sorted({f.at for a in row.arguments.values() for f in a.faults.values() if f.at})
    files = [path for path in spoiled if (whole / path).is_file()]
    assume(files)
    path = data.draw(st.sampled_from(files))
    root = tree / "one"
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir()
    lay_out(whole, row, root)
    content = (root / path).read_bytes()
    at = data.draw(st.integers(0, len(content)))
    cut = data.draw(st.integers(0, 16))
    middle = data.draw(st.one_of(st.binary(max_size=16), st.text(max_size=8).map(encoded)))
    (root / path).write_bytes(content[:at] + middle + content[at + cut :])
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        stop_at_work(row, patch)
        before = snapshot(root)
        outcome = run(words_of(command, row, None))
        happened = differences(before, snapshot(root))
    if outcome.code not in (0, REGRESSION if command == "regress" else 0):
        assert outcome.code == 2, outcome
        check_one_line(outcome, ())
        assert happened == {}
    else:
        assert set(happened.values()) <= {"new"}
        assert "Traceback" not in outcome.stderr


def encoded(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")


def test_every_command_has_joined() -> None:
    """A new command, or a new option of one, gets a line in ``commands``."""
    assert {name.partition(":")[0] for name in COMMANDS} == set(COMMAND.commands)
    for name, row in COMMANDS.items():
        assert set(row.arguments) == set(parameters(name)), name


def test_every_option_is_spoiled() -> None:
    """What takes a value takes a wrong one somewhere."""
    for command in COMMAND.commands:
        rows = [row for name, row in COMMANDS.items() if name.partition(":")[0] == command]
        for name, parameter in parameters(command).items():
            if not parameter.is_flag if parameter.param_type_name == "option" else True:
                assert any(row.arguments[name].faults for row in rows), f"{command} {name}"


def test_every_reader_has_joined() -> None:
    """A new reader of files gets a file of the tree that is spoiled."""
    assert set(READ) == set(READERS)
    spoiled = {f.at for row in COMMANDS.values() for a in row.arguments.values()
               for f in a.faults.values()}  # fmt: skip
    assert {path for path in READ.values() if path} <= spoiled


def test_there_are_many() -> None:
    assert len(CASES) >= 500
    assert len({case.id for case in CASES}) == len(CASES)


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
