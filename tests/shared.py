"""Folders that are built once per run of the tests, even if several processes share the run."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from filelock import FileLock


def run_folder(factory: pytest.TempPathFactory) -> Path:
    """Return the temporary folder of the run, which all of its processes share."""
    folder = factory.getbasetemp()
    return folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder


@contextmanager
def hold_lock(factory: pytest.TempPathFactory, name: str) -> Iterator[Path]:
    """Hold the lock ``name`` among the processes of the run; yield the folder of the run."""
    root = run_folder(factory)
    with FileLock(root / f"{name}.lock"):
        yield root


def make_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return the folder ``name``, which the first process that asks for it makes.

    Args:
        factory: of the run.
        name: of the folder, unique among the tests.
        make: fills the folder, which exists and is empty.
    """
    with hold_lock(factory, name) as root:
        folder, done = root / name, root / f"{name}.done"
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)  # of a process that failed to make it
            folder.mkdir()
            make(folder)
            done.touch()
    return folder
