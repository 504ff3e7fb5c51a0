"""Removal of temporary files and folders of killed processes."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from pathlib import Path
from typing import Final

from filelock import FileLock, Timeout

from objconnect.scene.storage.atomic import ASIDE_SUFFIX, PARTIAL_SUFFIX, TEMPORARY_PREFIX

_TEMPORARY: Final = re.compile(
    rf"{re.escape(TEMPORARY_PREFIX)}[a-z0-9_]{{8}}({PARTIAL_SUFFIX}|{ASIDE_SUFFIX})"
)
# Lock file inside a temporary folder; the system releases it when the process ends.
_IN_USE: Final = f"{TEMPORARY_PREFIX}in-use"


def make_folder_in_use(root: Path) -> tuple[Path, FileLock]:
    """Make a temporary folder in ``root``, and mark it as in use until the lock is released.

    Raises:
        OSError: the folder cannot be made.
    """
    while True:
        folder = Path(tempfile.mkdtemp(prefix=TEMPORARY_PREFIX, suffix=PARTIAL_SUFFIX, dir=root))
        lock = FileLock(folder / _IN_USE, thread_local=False)
        try:
            lock.acquire()
        except FileNotFoundError:
            # Another process removed the folder as abandoned, because it had no mark yet.
            continue
        except OSError:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        return folder, lock


def remove_partial(folder: Path) -> None:
    """Remove temporary files and folders of killed processes below ``folder``.

    A folder that was being replaced is restored. Folders in use and their contents stay.
    """
    used: set[Path] = set()
    temporary = [item for item in folder.rglob(f"{TEMPORARY_PREFIX}*") if _is_temporary(item)]
    for path in sorted(temporary):  # folders before their contents
        if used.intersection(path.parents):
            continue
        if not _remove_unused(path):
            used.add(path)


def remove_abandoned(folder: Path) -> None:
    """Remove temporary folders in ``folder`` that killed processes had marked as in use."""
    for path in folder.glob(f"{TEMPORARY_PREFIX}*{PARTIAL_SUFFIX}"):
        if _is_temporary(path) and (path / _IN_USE).exists():
            _remove_unused(path)


def _remove_unused(path: Path) -> bool:
    """Remove a temporary file, or a folder unless a process uses it; return whether it is removed.

    The mark of a folder is locked meanwhile, so that no process begins to use the folder.
    """
    if path.is_symlink() or not path.is_dir():
        path.unlink(missing_ok=True)
        return True
    is_marked = (path / _IN_USE).exists()
    lock = FileLock(path / _IN_USE, blocking=False)
    try:
        lock.acquire()
    except Timeout:
        return False
    except OSError:
        if is_marked:  # by another user
            return False
    if path.name.endswith(ASIDE_SUFFIX):
        _restore(path)
    shutil.rmtree(path, ignore_errors=True)
    lock.release()
    if os.name == "nt":  # Windows keeps the mark until it is closed
        shutil.rmtree(path, ignore_errors=True)
    return True


def _restore(aside: Path) -> None:
    """Move the old version of a folder back to its place, unless there is a new one."""
    for old in list(aside.iterdir()):
        if old.name != _IN_USE and not os.path.lexists(aside.parent / old.name):
            old.replace(aside.parent / old.name)


def _is_temporary(path: Path) -> bool:
    return _TEMPORARY.fullmatch(path.name) is not None
