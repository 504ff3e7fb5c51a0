"""The folder tree that misused commands run in."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.robustness.misuse import world
from tests.robustness.misuse.harness import memory


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("whole")
    world.make(root)
    return root


@pytest.fixture
def tree(whole: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder for the tree, where commands run, and beside it the system's temporary files."""
    with tempfile.TemporaryDirectory(dir=memory() or whole.parent) as folder:
        root = Path(folder) / "tree"
        temporary = Path(folder) / "tmp"
        root.mkdir()
        temporary.mkdir()
        for variable in ("TMPDIR", "TEMP", "TMP"):
            monkeypatch.setenv(variable, str(temporary))
        monkeypatch.setattr(tempfile, "tempdir", str(temporary))
        monkeypatch.setenv("XDG_CACHE_HOME", str(whole.parent / "cache"))
        monkeypatch.chdir(root)
        yield root
