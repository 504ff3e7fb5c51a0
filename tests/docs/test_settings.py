"""Documents give --set once per value, as the command line takes it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmark.cli.stray_words import refuse_stray_settings
from objconnect.scene.errors import InputError
from tests.docs import documents
from tests.docs.documents import DOCUMENTS, ROOT
from tests.docs.test_documents import COMMANDS

_CODE = ("objconnect", "simulate", "baselines", "benchmark", "experiments", "tests")
_FOLDERS = ("docs", "examples", *_CODE)
WRITTEN = sorted(
    path
    for folder in _FOLDERS
    for kind in ("*.md", "*.py", "*.mk", "*.yaml", "*.ipynb", "*.sh")
    for path in (ROOT / folder).rglob(kind)
    # What tests the mistake must write it.
    if path.name not in (Path(__file__).name, "test_shared_options.py", "stray_words.py")
)
# A value, perhaps in quotes, and then another KEY=VALUE without --set.
_TWO = re.compile(
    r"--set[ =]+(?:'[^'\n]*'|\"[^\"\n]*\"|[\w.]+=[^\s`'\"]+)\s+(?!-)['\"]?[a-z_][\w.]*="
)


def two_in_one(text: str) -> list[str]:
    """Return the places where --set is given two values."""
    return _TWO.findall(text.replace("\\\n", " "))


@pytest.mark.parametrize("path", [*DOCUMENTS, ROOT / "Makefile"], ids=documents.name)
def test_documents_give_one_value_each(path: Path) -> None:
    assert not two_in_one(path.read_text(encoding="utf-8"))


def test_code_and_examples_give_one_value_each() -> None:
    wrong = [
        documents.name(path) for path in WRITTEN if two_in_one(path.read_text(encoding="utf-8"))
    ]
    assert not wrong


@pytest.mark.parametrize("path", DOCUMENTS, ids=documents.name)
def test_no_word_of_a_command_stands_alone(path: Path) -> None:
    for name, *words in filter(None, documents.commands(path, "objconnect")):
        refuse_stray_settings(COMMANDS[name], words)


@pytest.mark.parametrize(
    "text",
    [
        "--set a=1 b=2",
        "--set a.b=x.h5 c.d=null",
        "--set 'a=[1,2]' b=2",
        "--set a=1 \\\n  b=2",
        "--set=a=1 b=2",
    ],
)
def test_the_mistake_is_noticed(text: str) -> None:
    assert two_in_one(text)
    words = text.replace("\\\n", " ").replace("'", "").split()
    with pytest.raises(InputError, match="stands alone"):
        refuse_stray_settings(COMMANDS["evaluate"], words)


def test_what_is_right_passes() -> None:
    assert not two_in_one("--set a=1 --set b=2 --out a=b and `--set a=1`, b=2")
