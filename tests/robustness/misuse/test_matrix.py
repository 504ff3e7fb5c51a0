"""Every command with every argument spoiled in every way its kind can be: one line and exit code 2,
before the work begins, and the tree is as it was."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from benchmark.cli.boundary import REGRESSION
from tests.robustness.fuzz.readers import READERS
from tests.robustness.misuse import world
from tests.robustness.misuse.arguments import Fault
from tests.robustness.misuse.cases import (
    CASES,
    Case,
    check_one_line,
    declare,
    lay_out,
    list_kept,
    names_of,
    parameters,
    stop_at_work,
    words_of,
)
from tests.robustness.misuse.commands import COMMANDS, READ
from tests.robustness.misuse.harness import COMMAND, differences, run, snapshot


def mark_thorough() -> Iterator[Any]:
    """Mark a fault thorough if another case has it: of an argument, or of a file's format."""
    seen: set[tuple[str, str]] = set()
    for case in CASES:
        kind = Path(case.fault.at).suffix or case.fault.at or case.argument, case.name
        yield pytest.param(case, id=case.id, marks=pytest.mark.thorough if kind in seen else ())
        seen.add(kind)


@pytest.mark.parametrize("case", mark_thorough())
def test_every_misuse_is_one_line_and_changes_nothing(
    case: Case, whole: Path, tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
        assert happened.keys() - declare(case, row, happened) == set()
        return
    assert not outcome.begun, "the work began"
    assert outcome.code == 2, outcome
    if row.reports and outcome.stdout:
        assert any(word in outcome.stdout for word in names_of(case)), outcome
        assert outcome.stderr == ""
    else:
        check_one_line(outcome, names_of(case))
    assert {name: happened[name] for name in happened.keys() - list_kept(row, happened)} == {}


# Words that contradict each other, and what the error names.
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
        (
            "localize",
            "--map",
            "meadow",
            "--images",
            "photos",
            "--priors",
            "tables/priors.csv",
            "--out",
            "tables/priors.txt",
        ),
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
        (
            "score",
            "tables/poses.txt",
            "--reference",
            "meadow",
            "--method",
            "sift",
            "--out",
            "results",
        ),
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
    "submit_a_folder": (("submit", "mine", "--out", "out"), ("mine",)),
    "start_of_cmu": (("submit", "cmu", "--start", "none", "--out", "out"), ("--start",)),
    "sealed_scene_of_a_public_seed": (
        ("publish", "hamlet", "--sealed", "--out", "out"),
        ("hamlet",),
    ),
    "sealed_layers": (
        ("publish", "hamlet", "--sealed", "--layer", "depth", "--out", "out"),
        ("--layer",),
    ),
    "key_of_no_sealed_place": (
        ("track", "tiny", "--board", "board", "--sealed", "photos/p0.jpg", "--out", "out"),
        ("--sealed",),
    ),
    "container_in_threads": (
        ("evaluate", "hamlet", "--method", "a", "--container", "a", "--jobs", "2", "--out", "out"),
        ("--container",),
    ),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_contradicting_options_are_refused(name: str, whole: Path, tree: Path) -> None:
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
def test_wrong_usage_is_one_line(words: tuple[str, ...], tree: Path) -> None:
    check_refused(words, (), tree)


def check_refused(words: Sequence[str], says: tuple[str, ...], tree: Path) -> None:
    """One line, exit code 2, and nothing else."""
    before = snapshot(tree.parent)
    outcome = run(words)
    assert outcome.code == 2, outcome
    check_one_line(outcome, says)
    assert differences(before, snapshot(tree.parent)) == {}


# Commands that end at once whatever they are given.
QUICK = ("score", "leaderboard", "regress", "export", "train", "calibrate", "ingest")


@given(st.data())
@settings(
    max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
def test_random_words_never_crash_a_command(whole: Path, tree: Path, data: st.DataObject) -> None:
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
def test_random_bytes_in_a_file_never_crash_a_command(
    whole: Path, tree: Path, data: st.DataObject
) -> None:
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
    middle = data.draw(st.one_of(st.binary(max_size=16), st.text(max_size=8).map(encode)))
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


def encode(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")


def test_every_command_and_option_has_a_row() -> None:
    """A new command, or a new option of one, gets a line in ``commands``."""
    assert {name.partition(":")[0] for name in COMMANDS} == set(COMMAND.commands)
    for name, row in COMMANDS.items():
        assert set(row.arguments) == set(parameters(name)), name


def test_every_option_gets_a_wrong_value() -> None:
    """What takes a value takes a wrong one somewhere."""
    for command in COMMAND.commands:
        rows = [row for name, row in COMMANDS.items() if name.partition(":")[0] == command]
        for name, parameter in parameters(command).items():
            if not parameter.is_flag if parameter.param_type_name == "option" else True:
                assert any(row.arguments[name].faults for row in rows), f"{command} {name}"


def test_every_reader_has_a_damaged_file() -> None:
    """A new reader of files gets a file of the tree that is spoiled."""
    assert set(READ) == set(READERS)
    spoiled = {f.at for row in COMMANDS.values() for a in row.arguments.values()
               for f in a.faults.values()}  # fmt: skip
    assert {path for path in READ.values() if path} <= spoiled


def test_there_are_at_least_500_cases() -> None:
    assert len(CASES) >= 500
    assert len({case.id for case in CASES}) == len(CASES)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_works_without_a_fault(
    command: str, whole: Path, tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a fault the same words work, or come to the work, and write what they say."""
    row = COMMANDS[command]
    lay_out(whole, row, tree)
    stop_at_work(row, monkeypatch)
    before = snapshot(tree.parent)
    outcome = run(words_of(command, row, None))
    happened = differences(before, snapshot(tree.parent))
    assert outcome.code == 0, outcome
    assert outcome.begun == bool(row.work)
    assert happened.keys() - declare(None, row, happened) == set()
