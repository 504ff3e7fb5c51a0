"""Removal of temporary files and folders of killed processes."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from filelock import FileLock, Timeout

from objconnect.scene.storage.atomic import ASIDE_SUFFIX, PARTIAL_SUFFIX, TEMPORARY_PREFIX

_TEMPORARY: Final = re.compile(
    rf"{re.escape(TEMPORARY_PREFIX)}[a-z0-9_]{{8}}({PARTIAL_SUFFIX}|{ASIDE_SUFFIX})"
)
# Lock file inside a temporary folder; the system releases it when the process ends.
_IN_USE: Final = f"{TEMPORARY_PREFIX}in-use"


@contextmanager
def mark_in_use(folder: Path) -> Iterator[None]:
    """Mark a temporary folder as in use by a living process during the block."""
    with FileLock(folder / _IN_USE, thread_local=False):
        yield


def remove_partial(folder: Path) -> None:
    """Remove temporary files and folders of killed processes below ``folder``.

    A folder that was being replaced is restored. Folders in use and their contents stay.
    """
    used: set[Path] = set()
    temporary = [item for item in folder.rglob(f"{TEMPORARY_PREFIX}*") if _is_temporary(item)]
    for path in sorted(temporary):  # folders before their contents
        if used.intersection(path.parents):
            continue
        if _is_used(path):
            used.add(path)
            continue
        if path.name.endswith(ASIDE_SUFFIX):
            for old in list(path.iterdir()):
                if not os.path.lexists(path.parent / old.name):
                    old.replace(path.parent / old.name)
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def remove_abandoned(folder: Path) -> None:
    """Remove temporary folders in ``folder`` that killed processes had marked as in use."""
    for path in folder.glob(f"{TEMPORARY_PREFIX}*{PARTIAL_SUFFIX}"):
        if _is_temporary(path) and (path / _IN_USE).exists() and not _is_used(path):
            shutil.rmtree(path, ignore_errors=True)


def _is_temporary(path: Path) -> bool:
    return _TEMPORARY.fullmatch(path.name) is not None


def _is_used(path: Path) -> bool:
    if not (path / _IN_USE).is_file():
        return False
    try:
        with FileLock(path / _IN_USE, blocking=False):
            return False
    except (OSError, Timeout):  # Timeout: its process lives; OSError: it is another user's
        return True
