"""Folders that are built once per run of the tests, even if several processes share it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from filelock import FileLock


def root_of(factory: pytest.TempPathFactory) -> Path:
    """The temporary folder of the run, which all of its processes see."""
    folder = factory.getbasetemp()
    return folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder


@contextmanager
def alone(factory: pytest.TempPathFactory, name: str) -> Iterator[Path]:
    """Keep the other processes of the run out of what ``name`` stands for; yield the root."""
    root = root_of(factory)
    with FileLock(root / f"{name}.lock"):
        yield root


def make_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return the folder ``name``, which the first process that asks for it makes.

    Args:
        factory: of the run.
        name: of the folder, unique among the tests.
        make: fills the folder, which exists and is empty.
    """
    with alone(factory, name) as root:
        folder, done = root / name, root / f"{name}.done"
        if not done.exists():
            folder.mkdir()
            make(folder)
            done.touch()
    return folder
