"""Locks against two runs in one folder, and files that survive an interrupted run."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.storage.atomic import TEMPORARY_PREFIX

_LOCK = f"{TEMPORARY_PREFIX}lock"


@contextmanager
def write_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder during the block, so that no second run writes there.

    The operating system releases the lock when the process ends. The lock file is removed after the
    block, and so are new folders that are still empty.

    Raises:
        InputError: another process holds the lock, or the folder cannot be made or written.
    """
    new_folders = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise WriteError(f"cannot write {folder}: {error.strerror or error}") from None
        with hold_lock(folder / _LOCK, folder):
            yield
    finally:
        with suppress(OSError):  # a folder that is not empty stays
            for path in new_folders:
                path.rmdir()


@contextmanager
def hold_lock(lock: Path, what: Path) -> Iterator[None]:
    """Hold a lock file during the block, and remove it afterwards.

    Args:
        lock: lock file; its folder exists.
        what: path that the lock protects, for the message.

    Raises:
        InputError: another process holds the lock, or the file cannot be made.
    """
    file_lock = FileLock(lock, blocking=False, thread_local=False)
    try:
        file_lock.acquire()
    except Timeout:
        raise InputError(f"another run is writing {what}: wait for it to end") from None
    except (OSError, NotImplementedError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise WriteError(f"cannot write {what}: {reason or error}") from None
    try:
        yield
    finally:
        # Unlink before the release: a process that has opened the file then notices and tries
        # again. Windows does not allow this and keeps the file.
        with suppress(OSError):
            lock.unlink()
        file_lock.release()


@contextmanager
def resumable_file(folder: Path, name: str) -> Iterator[Path]:
    """Yield the path of a file that a later run can resume from.

    The file survives an interruption of the block and a WriteError, such as a full disk. It is
    removed if the block succeeds or fails with another error. Files of other names in the folder
    are removed at the start.

    Args:
        folder: folder for this file alone; it is created and removed here.
        name: file name that identifies the work, so that no run resumes other work.

    Raises:
        InputError: the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for other in folder.iterdir():
            # The names of a database's journals begin with the name of the database.
            if not other.name.startswith(name) and other.is_file():
                other.unlink()
    except OSError as error:
        raise WriteError(f"cannot write {folder}: {error.strerror or error}") from error
    try:
        yield folder / name
    except WriteError:
        raise
    except Exception:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    shutil.rmtree(folder, ignore_errors=True)
