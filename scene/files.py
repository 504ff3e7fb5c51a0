"""Files that are either whole or absent, and their digests."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from scene.errors import InputError, WriteError

# What mkstemp makes of the prefix ".NAME.".
_PARTIAL = ".*.????????"
# Bytes of a name, in every usual file system.
_LONGEST = 255
# A disk with less left is full.
_FULL = 1 << 20


def sha256_of(path: Path) -> str:
    """Hex digest of a file's bytes."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def inside(name: str) -> bool:
    """Whether a path in a list of files, which says where in their folder they are, stays there,
    and a file can have it."""
    parts = name.split("/")
    short = all(len(part.encode("utf-8", "surrogatepass")) <= _LONGEST for part in parts)
    return short and "\0" not in name and not name.startswith("/") and ".." not in parts


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place only when the block succeeds.

    Raises:
        WriteError: the folder cannot be written, or the disk is full.
    """
    partial: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        os.close(handle)
        partial = Path(name)
        # mkstemp makes private files; a result should be as readable as any other file.
        partial.chmod(0o666 & ~_umask())
        yield partial
        partial.replace(path)
    except OSError as error:
        raise WriteError(f"cannot write {path}: {error.strerror or error}") from error
    except RuntimeError as error:
        # Libraries that write by themselves have many words for it.
        if shutil.disk_usage(path.parent).free >= _FULL:
            raise
        raise WriteError(f"cannot write {path}: the disk is full") from error
    finally:
        if partial is not None:
            partial.unlink(missing_ok=True)


def remove_partial(folder: Path) -> None:
    """Remove what processes killed inside ``written_whole`` or ``folder_written_whole`` left under
    ``folder``."""
    for path in list(folder.rglob(_PARTIAL)):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


@contextmanager
def folder_written_whole(path: Path) -> Iterator[Path]:
    """The same for a folder: ``path`` is replaced only when the block succeeds.

    Raises:
        InputError: the parent folder cannot be written, or the disk is full.
    """
    partial: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
        partial.chmod(0o777 & ~_umask())
        yield partial
        if path.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{path.name}.old.", dir=path.parent))
            path.replace(old / path.name)
            partial.replace(path)
            shutil.rmtree(old)
        else:
            partial.replace(path)
    except OSError as error:
        raise WriteError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        if partial is not None:
            shutil.rmtree(partial, ignore_errors=True)


@contextmanager
def kept_while_working(folder: Path, name: str) -> Iterator[Path]:
    """The path of a file that outlives an interruption of the block and a place that could not be
    written, but neither its success nor its failure; whatever else an interrupted block left in
    ``folder`` is removed.

    Args:
        folder: of this file alone, made here and removed at the end.
        name: says what the block works on, so that nobody goes on from another's work.

    Raises:
        InputError: the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for other in folder.iterdir():
            # A database has journals beside it.
            if not other.name.startswith(name):
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


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Keep others that ask for it out of a folder during the block.

    The lock is the kernel's, on the folder itself: it leaves no file, and ends with the process,
    however that ends. A folder that is not there is made, and goes again if it stays empty.

    Raises:
        InputError: another process has it, or the folder cannot be made.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise InputError(f"cannot write {folder}: {error.strerror}") from None
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"another run is writing {folder}: wait for it to end") from None
        yield
    finally:
        os.close(handle)
        with suppress(OSError):  # not empty, which is as it should be
            for path in made:
                path.rmdir()


def require_room(path: Path, needed: int) -> None:
    """Refuse to write what the disk cannot hold, for those who end badly on a full one.

    Args:
        path: of a file or folder that need not exist yet, in a folder that does.
        needed: bytes.

    Raises:
        WriteError: there is less room.
    """
    free = shutil.disk_usage(path.parent).free
    if free < needed:
        raise WriteError(
            f"cannot write {path}: the disk has {free / 1e6:.0f} MB left and {needed / 1e6:.0f} MB "
            "are needed: free some and run again"
        )


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically.

    Raises:
        InputError: as ``written_whole``.
    """
    with written_whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


def read_text(path: Path, what: str) -> str:
    """Read a text file.

    Raises:
        InputError: ``what`` is missing, unreadable or not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not a UTF-8 text file"
        raise InputError(f"cannot read {what} {path}: {reason}") from error


def parse_json(text: str) -> Any:
    """JSON that a stranger may have written.

    Raises:
        ValueError: it is none, or nested thousands deep.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
