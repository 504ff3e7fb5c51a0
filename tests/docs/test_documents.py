"""What the documents name exists: files, tests, commands, options, functions."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer.main

from benchmark.cli import app
from objconnect.scene.bundle.scene import Scene
from tests.docs import documents
from tests.docs.documents import DOCUMENTS, GUIDES, ROOT

COMMANDS: dict[str, Any] = vars(typer.main.get_command(app))["commands"]

MOST_WORDS = 1000
# Made by `python -m experiments.gallery`.
GENERATED = {"docs/gallery.md"}
TOP = {path.name for path in ROOT.iterdir() if path.is_dir() and not path.name.startswith(".")}
# Folders that runs make, not the repository.
MADE = {"runs", "build", "dist"}
_PATH = re.compile(r"([\w.-]+/[\w./-]*)(?:::(\w+))?")
# A name in capitals stands for one of the reader's.
_BLANK = re.compile(r"(?<![\w-])(NAME|FILE|DIR|KIND)(?![\w-])")

every_document = pytest.mark.parametrize("path", DOCUMENTS, ids=documents.name)


def require_path(text: str) -> None:
    """Fail unless a path of the repository, perhaps with the name of a test, exists."""
    found = _PATH.fullmatch(text)
    if found is None or found[1].split("/")[0] not in TOP - MADE or _BLANK.search(text):
        return
    path = ROOT / found[1]
    assert path.exists(), f"{text}: no such file"
    if found[2] is not None:
        assert re.search(rf"^(async )?def {found[2]}\(", path.read_text(encoding="utf-8"), re.M), (
            f"{text}: no such test"
        )


@every_document
def test_links_lead_somewhere(path: Path) -> None:
    for target in documents.links(path):
        assert (path.parent / target.split("#")[0]).exists(), f"{target}: no such file"


@every_document
def test_named_files_and_tests_exist(path: Path) -> None:
    words = [word for code in documents.inline_code(path) for word in code.split()]
    for words_of_line in documents.shell_lines(path):
        words += words_of_line
    for word in words:
        require_path(word)


@every_document
def test_named_modules_exist(path: Path) -> None:
    lines = documents.shell_lines(path)
    lines += [code.split() for code in documents.inline_code(path)]
    for words in lines:
        if "-m" in words and any(word.startswith("python") or "/python" in word for word in words):
            module = words[words.index("-m") + 1]
            if module.split(".")[0] in TOP:
                file = ROOT / module.replace(".", "/")
                assert file.with_suffix(".py").is_file() or (file / "__main__.py").is_file(), module


def require_options(arguments: list[str]) -> Any:
    """Fail unless a sub command exists and has every option that is named."""
    assert arguments[0] in COMMANDS, f"no command {arguments[0]}"
    command = COMMANDS[arguments[0]]
    known = {name for parameter in command.params for name in parameter.opts} | {"--help"}
    for word in arguments[1:]:
        assert not word.startswith("--") or word.split("=")[0] in known, (
            f"{arguments[0]} has no option {word}"
        )
    return command


@every_document
def test_commands_are_those_of_the_command_line(path: Path) -> None:
    """Commands in blocks are parsed whole; in the text they may leave something out."""
    for arguments in documents.commands(path, "objconnect"):
        if arguments:
            require_options(arguments).make_context(arguments[0], arguments[1:])
    for code in documents.inline_code(path):
        if code.startswith("objconnect ") and "[" not in code:
            arguments = shlex.split(re.sub(r"\$\w+", "1", code))[1:]
            if not arguments[0].startswith("-"):
                require_options(arguments)


@every_document
def test_python_imports_what_exists(path: Path) -> None:
    for block in documents.blocks(path, "python"):
        assert "--8 <" not in block, "a formatter broke the mark of an included file"
        if block.startswith("--8<--"):
            assert (ROOT / block.split('"')[1]).is_file()
            continue
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom):
                assert node.module is not None
                module = importlib.import_module(node.module)
                for alias in node.names:
                    assert hasattr(module, alias.name), f"{node.module} has no {alias.name}"


@pytest.mark.parametrize("guide", ["scene.md", "localize.md"])
def test_python_of_guides_runs(
    guide: str, rendered: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "SCENE").symlink_to(rendered.path)
    photographs = rendered.images_root / "summer-noon-nadir-query" / "images"
    (tmp_path / "NEW_PHOTOGRAPHS").symlink_to(photographs)
    monkeypatch.chdir(tmp_path)
    for block in documents.blocks(ROOT / "docs" / guide, "python"):
        exec(compile(block, guide, "exec"), {})


@pytest.mark.parametrize("path", GUIDES, ids=documents.name)
def test_guides_are_short(path: Path) -> None:
    if documents.name(path) not in GENERATED:
        assert len(documents.prose(path).split()) <= MOST_WORDS


def test_the_first_pages_are_short() -> None:
    """README is two minutes aloud without its tables, and CONTRIBUTING is a page."""
    text = re.sub(r"<!--.*?-->", "", documents.prose(ROOT / "README.md"))
    lines = [line for line in text.splitlines() if not line.startswith("|")]
    assert len(" ".join(lines).split()) <= 700
    assert len((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").splitlines()) <= 60


def test_every_command_is_in_a_guide() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in DOCUMENTS)
    missing = [name for name in COMMANDS if f"objconnect {name}" not in text]
    assert not missing


def list_references() -> list[str]:
    """Return the modules that the reference shows."""
    pages = sorted((ROOT / "docs" / "reference").glob("*.md"))
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    return re.findall(r"^::: (\S+)$", text, re.MULTILINE)


@pytest.mark.parametrize("module", list_references())
def test_public_names_have_docstrings(module: str) -> None:
    path = ROOT / module.replace(".", "/")
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    tree = ast.parse(file.read_text(encoding="utf-8"))
    undocumented = []
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    for node in [tree, *tree.body]:
        public = isinstance(node, ast.ClassDef) and not node.name.startswith("_")
        inner = node.body if public else []
        for part in (node, *inner):
            if isinstance(part, kinds) and not part.name.startswith("_"):
                if ast.get_docstring(part) is None:
                    undocumented.append(part.name)
            elif isinstance(part, ast.Module) and ast.get_docstring(part) is None:
                undocumented.append(module)
    assert not undocumented
