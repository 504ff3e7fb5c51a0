"""The documents of the repository, and what is in them."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parents[2]
GUIDES = sorted((ROOT / "docs").glob("*.md"))
DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *GUIDES,
    *sorted((ROOT / "docs" / "evidence").glob("*.md")),
    *sorted((ROOT / "docs" / "reference").glob("*.md")),
]

_BLOCK = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\]\(([^)\s]+)\)")
_CODE = re.compile(r"`([^`\n]+)`")


def name(path: Path) -> str:
    """Return a document's path from the root of the repository."""
    return path.relative_to(ROOT).as_posix()


def prose(path: Path) -> str:
    """Return the text of a document without its blocks of code."""
    return _BLOCK.sub("", path.read_text(encoding="utf-8"))


def blocks(path: Path, language: str) -> list[str]:
    """Return the blocks of code of a document in one language."""
    found = _BLOCK.findall(path.read_text(encoding="utf-8"))
    return [body for kind, body in found if kind == language]


def links(path: Path) -> list[str]:
    """Return the targets of a document's links and pictures that lie in the repository."""
    found: list[str] = _LINK.findall(prose(path))
    return [target for target in found if not target.startswith(("http", "#", "mailto"))]


def inline_code(path: Path) -> list[str]:
    """Return what stands in backticks within a document's prose."""
    return _CODE.findall(prose(path))


def shell_lines(path: Path) -> list[list[str]]:
    """Return the commands of a document's shell blocks as words, one for each command.

    Lines that end in a backslash are joined; comments, variables and words of the shell are left
    out, so that a variable stands as the number 1.
    """
    lines = []
    for block in blocks(path, "sh"):
        for line in block.replace("\\\n", " ").splitlines():
            if line.startswith("#SBATCH"):
                continue
            words = shlex.split(re.sub(r"\$\w+", "1", line), comments=True)
            lines.append(words)
    return [words for words in lines if words]


def commands(path: Path, program: str) -> list[list[str]]:
    """Return the arguments of each call of a program in a document's shell blocks."""
    found = []
    for words in shell_lines(path):
        if program in words:
            arguments = words[words.index(program) + 1 :]
            end = next((k for k, word in enumerate(arguments) if word in {";", "&", "|"}), None)
            found.append(arguments[:end])
    return found
