"""Documents and code keep to the vocabulary: a word that it rejects stands nowhere."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs import documents
from tests.docs.documents import DOCUMENTS, ROOT
from tests.docs.measure_packages import PACKAGES

VOCABULARY = ROOT / "docs" / "vocabulary.md"
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
_FUNCTION = re.compile(r"^\s*(?:async )?def (\w+)", re.MULTILINE)
_PARTICIPLE = re.compile(
    r"_*(?!is_|has_|can_|speed|red|seed|shed|embed)"
    r"([a-z]+ed(_\w+)?|\w+_[a-z]+ed|(laid|made|seen|given|found)(_\w+)?)"
)


def tables() -> Iterator[tuple[str, str]]:
    """Yield the heading and the first cell of every row of the vocabulary's tables."""
    heading = ""
    for line in VOCABULARY.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
        elif line.startswith("| "):
            yield heading, line.split("|")[1].strip()


REJECTED = [
    word for heading, word in tables() if heading == "Rejected words" and word != "rejected"
]
DEFINED = [
    word.strip()
    for heading, cell in tables()
    if heading != "Rejected words"
    for word in cell.split(",")
    if word != "word"
]


def lines_with(word: str, paths: list[Path]) -> list[str]:
    """Return where a word stands, as ``file:line``."""
    pattern = re.compile(rf"(?<![\w-]){word}(?![\w-])".replace(" ", r"\s+"), re.IGNORECASE)
    found = []
    for path in paths:
        text = path.read_text(encoding="utf-8")
        found += [
            f"{documents.name(path)}:{text.count(chr(10), 0, match.start()) + 1}"
            for match in pattern.finditer(text)
        ]
    return found


def test_every_word_is_defined_once() -> None:
    assert len(DEFINED) == len(set(DEFINED)) > 30
    assert not set(DEFINED) & set(REJECTED)


@pytest.mark.parametrize("word", REJECTED)
def test_a_rejected_word_stands_nowhere(word: str) -> None:
    pages = [path for path in DOCUMENTS if path != VOCABULARY]
    assert not lines_with(word, [*pages, *SOURCES])


def test_a_rejected_word_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(documents, "ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("The Place\nsearch of places.\nNo shelf-life, one shelf.\n", encoding="utf-8")
    assert lines_with("place search", [page]) == ["page.md:1"]
    assert lines_with("shelf", [page]) == ["page.md:3"]


def function_names() -> list[str]:
    """Return the name of every function of the packages."""
    texts = (path.read_text(encoding="utf-8") for path in SOURCES)
    return [name for text in texts for name in _FUNCTION.findall(text)]


def test_functions_are_not_named_by_participles() -> None:
    """``judged`` or ``_laid_out`` do not say what a function does."""
    names = function_names()
    participles = [name for name in names if _PARTICIPLE.fullmatch(name)]
    assert len(participles) <= 0.02 * len(names), participles
