"""Options of several commands mean one thing: --set, --jobs and --start."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import typer.main

from benchmark.cli import app
from benchmark.cli.arguments import parse_settings
from benchmark.cli.stray_words import refuse_stray_settings, refuse_taken_options
from objconnect.scene.errors import InputError
from tests.benchmark.test_cli import error_line, invoke

COMMANDS: dict[str, Any] = vars(typer.main.get_command(app))["commands"]

# Commands with each option, and the default of each: a start is told where the command has one.
DEFAULTS: dict[str, dict[str, object]] = {
    "--set": dict.fromkeys(
        ("localize", "evaluate", "basin", "submit", "train", "forecast", "ingest")
    ),
    "--jobs": dict.fromkeys(("evaluate", "submit", "simulate", "track", "forecast"), 1),
    "--start": {
        "evaluate": "prior",
        "forecast": "prior",
        "score": "none",
        "submit": "prior",
    },
}


def option_of(command: str, name: str) -> Any:
    return next((part for part in COMMANDS[command].params if name in part.opts), None)


def definition(option: Any) -> tuple[object, ...]:
    """All of an option but its default and its parameter's name."""
    return (
        option.opts,
        option.help,
        option.metavar,
        getattr(option, "min", None),
        getattr(option, "max", None),
        option.multiple,
        option.nargs,
        option.callback is None,
    )


@pytest.mark.parametrize("name", list(DEFAULTS))
def test_every_command_has_one_definition(name: str) -> None:
    having = {command for command in COMMANDS if option_of(command, name) is not None}
    assert having == set(DEFAULTS[name])
    assert len({repr(definition(option_of(command, name))) for command in having}) == 1


@pytest.mark.parametrize("name", list(DEFAULTS))
def test_the_help_shows_the_default(name: str) -> None:
    for command, default in DEFAULTS[name].items():
        assert (option_of(command, name).default or None) == default
        shown = invoke(command, "--help").stdout
        assert name in shown
        if default is not None:
            assert f"default: {default}" in " ".join(shown.split())


@pytest.mark.parametrize("command", list(DEFAULTS["--set"]))
def test_a_second_value_that_stands_alone_is_explained(command: str) -> None:
    result = invoke(command, "--set", "a=1", "b=2")
    assert result.exit_code == 2
    line = error_line(result.stderr)
    assert "'b=2' stands alone: --set is given once per value" in line
    assert "--set b=2" in line


@pytest.mark.parametrize(
    "words",
    [
        ("evaluate", "b=2", "--method", "sift", "--out", "OUT"),
        ("evaluate", "DATASET", "ratio=0.7", "--method", "sift", "--out", "OUT"),
        ("evaluate", "--set=a=1", "b=2", "DATASET", "--method", "sift", "--out", "OUT"),
        ("basin", "DATASET", "--set", "a=1", "place.candidates=0", "--method", "sift"),
        ("submit", "references=5", "--out", "OUT"),
        ("train", "objconnect", "--set", "steps=1", "batch=2", "--out", "OUT"),
        ("train", "steps=1"),
        ("localize", "--json", "weights=a.safetensors", "--map", "PLACE"),
        ("forecast", "--", "gap_m=3"),
    ],
)
def test_a_stray_setting_is_refused_wherever_it_stands(words: tuple[str, ...]) -> None:
    result = invoke(*words)
    assert result.exit_code == 2
    assert "stands alone" in error_line(result.stderr)


def test_a_data_set_may_have_an_equals_sign(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gsd=5").mkdir()
    refuse_stray_settings(COMMANDS["evaluate"], ["gsd=5", "runs/gsd=7", "--out", "a=1"])
    with pytest.raises(InputError, match="'gsd=7' stands alone"):
        refuse_stray_settings(COMMANDS["evaluate"], ["gsd=7"])


def test_commands_without_settings_are_left_alone() -> None:
    assert "stands alone" not in invoke("validate", "a=1").stderr
    assert "No such option" in invoke("evaluate", "--sett", "a=1", "b=2").stderr


@pytest.mark.parametrize(
    "words", [("a=1", "a=2"), ("a=1", "b=1", "a=1"), ("search.again=true", "search.again=false")]
)
def test_two_values_of_one_key_are_refused(words: tuple[str, ...]) -> None:
    key = words[0].partition("=")[0]
    with pytest.raises(InputError, match=f"^--set {key} is given twice"):
        parse_settings(words)


@pytest.mark.parametrize(
    "words",
    [
        ("evaluate", "DATASET", "--method", "sift", "--out", "OUT"),
        ("simulate", "--out", "OUT"),
        ("track", "uav-seasons", "--out", "OUT"),
    ],
)
def test_jobs_beside_a_cluster_are_refused(words: tuple[str, ...]) -> None:
    """Jobs are those of this machine; beside a cluster they would change nothing."""
    having = {command for command in COMMANDS if option_of(command, "--jobs") is not None}
    both = {command for command in having if option_of(command, "--cluster") is not None}
    assert both == {"evaluate", "simulate", "track"}
    result = invoke(*words, "--jobs", "3", "--cluster", "local")
    assert result.exit_code == 2
    assert "--jobs 3 is for this machine alone" in error_line(result.stderr)


@pytest.mark.parametrize(
    ("words", "taken"),
    [
        (("evaluate", "DATASET", "--start", "--out", "OUT"), "--start has no value: --out"),
        (("evaluate", "--set", "--method", "sift", "DATASET"), "--set has no value: --method"),
        (("localize", "--map", "--images", "DIR"), "--map has no value: --images"),
        (("view", "SCENE", "--results", "--out=a.html"), "--results has no value: --out=a.html"),
        (("view", "scene", "--out", "--json"), "--out has no value: --json"),
    ],
)
def test_an_option_is_not_taken_as_a_value(words: tuple[str, ...], taken: str) -> None:
    result = invoke(*words)
    assert result.exit_code == 2
    assert taken in error_line(result.stderr)


@pytest.mark.parametrize("command", ["evaluate", "basin"])
def test_a_method_is_given_once(command: str) -> None:
    words = ("DATASET", "--out", "OUT", "--method", "sift", "--method", "prior", "--method", "sift")
    result = invoke(command, *words)
    assert result.exit_code == 2
    assert "--method sift is given 2 times" in error_line(result.stderr)


def test_arguments_may_be_called_as_they_like() -> None:
    """An argument of click has a name, too, and a path of that name is not an option."""
    for command in COMMANDS.values():
        words = [part.name for part in command.params]
        refuse_taken_options(command, [*words, "--out", "out", "--json", "--", "--out", "--out"])
        refuse_taken_options(command, ["--out=--json", "--out", "-x"])


@pytest.mark.parametrize("word", ["a=1 b=2", "a=1,b=2", "a=x.pth, c.d=true", "a=0.7;b=2"])
def test_two_settings_in_one_word_are_refused(word: str) -> None:
    with pytest.raises(InputError, match="--set is given once per value"):
        parse_settings([word])


@pytest.mark.parametrize(
    "word", ["a=[0.5,1,2]", "a={b: 1, c: d=e}", "a=x=y", "a='1 b=2'", "a=1 2", "a=x/y.pth"]
)
def test_one_setting_may_hold_much(word: str) -> None:
    assert list(parse_settings([word])) == ["a"]
