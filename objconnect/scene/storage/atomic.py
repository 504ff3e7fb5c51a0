"""Atomic writes: a file or folder is either whole or absent.

Data is first written under a temporary name of this program, ``.objconnect-????????.partial`` and
the like. No other file is ever removed: a folder that is replaced keeps what others wrote into it.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Final

from objconnect.scene.errors import WriteError

TEMPORARY_PREFIX: Final = ".objconnect-"
"""The beginning of every temporary name; see ``is_temporary``."""
PARTIAL_SUFFIX: Final = ".partial"
"""The end of the name of a file or folder that is being written."""

ASIDE_SUFFIX: Final = ".aside"
"""The end of the name of a folder that holds the old version of one that is being replaced; after a
kill it is the only copy."""

# A disk with fewer bytes left counts as full.
_FULL_BYTES = 1 << 20


def is_temporary(name: str) -> bool:
    """Return whether a file or folder of this name is a temporary one of this program."""
    return name.startswith(TEMPORARY_PREFIX)


def require_regular(path: Path) -> None:
    """Refuse to write where the path is anything that a file must not replace.

    Raises:
        WriteError: ``path`` is a folder, a device, a pipe, a socket or a symbolic link.
    """
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    except OSError as error:
        raise WriteError(f"cannot write {path}: {error.strerror or error}") from None
    if stat.S_ISREG(mode):
        return
    if stat.S_ISLNK(mode):
        raise WriteError(f"cannot write {path}: it is a symbolic link: name the file it leads to")
    kind = "a folder" if stat.S_ISDIR(mode) else "a device or a pipe"
    raise WriteError(f"cannot write {path}: it is {kind}, not a file")


@contextmanager
def atomic_write(path: Path, beside: Path | None = None) -> Iterator[Path]:
    """Write a file atomically: yield a temporary path that becomes ``path`` if the block succeeds.

    Args:
        path: of the file.
        beside: folder of the temporary path, on the same disk; None for that of the file.

    Raises:
        WriteError: the folder cannot be written, the disk is full, or ``path`` is something other
            than a regular file.

    Example:
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "result.txt"
        ...     with atomic_write(path) as partial:
        ...         _ = partial.write_text("done")
        ...     path.read_text()
        'done'
    """
    partial: Path | None = None
    try:
        require_regular(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            prefix=TEMPORARY_PREFIX, suffix=PARTIAL_SUFFIX, dir=beside or path.parent
        )
        os.close(handle)
        partial = Path(name)
        # mkstemp makes files that only this user may read; results get the usual permissions.
        partial.chmod(0o666 & ~_umask())
        yield partial
        partial.replace(path)
    except WriteError:
        raise
    except OSError as error:
        raise WriteError(f"cannot write {path}: {_reason(error, partial)}") from error
    except RuntimeError as error:
        _require_room(path, path.parent, error)
        raise
    finally:
        if partial is not None:
            partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file atomically.

    Raises:
        InputError: the file cannot be written, as for ``atomic_write``.
    """
    with atomic_write(path) as partial:
        partial.write_text(text, encoding="utf-8")


@contextmanager
def atomic_folder(path: Path, owned: Collection[str] = ()) -> Iterator[Path]:
    """Write a folder atomically: yield a temporary folder that becomes ``path`` if the block
    succeeds.

    Files of the old folder that the block did not write again are kept, except those of ``owned``.

    Args:
        path: folder to write; if it is a symbolic link, the folder it leads to is replaced.
        owned: paths, relative to the folder, of all files that this program may write there. Those
            of the old folder that the block does not write again are removed.

    Raises:
        InputError: the parent folder cannot be written, or the disk is full.
    """
    partial: Path | None = None
    named = path
    try:
        path = path.resolve()
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(
            tempfile.mkdtemp(prefix=TEMPORARY_PREFIX, suffix=PARTIAL_SUFFIX, dir=path.parent)
        )
        partial.chmod(0o777 & ~_umask())
        yield partial
        replace_folder(path, partial, owned)
    except WriteError as error:
        if partial is None or str(partial) not in str(error):
            raise
        # What could not be written is named by where it would be, and not by a hidden folder.
        raise WriteError(str(error).replace(str(partial), str(named))) from error
    except OSError as error:
        raise WriteError(f"cannot write {named}: {_reason(error, partial)}") from error
    except RuntimeError as error:
        if partial is not None:
            _require_room(named, path.parent, error)
        raise
    finally:
        if partial is not None:
            shutil.rmtree(partial, ignore_errors=True)


def replace_folder(path: Path, new: Path, owned: Collection[str]) -> None:
    """Replace the folder ``path`` by ``new``, which also receives the files of others in ``path``.

    Files of others are those that ``new`` does not have and that are not in ``owned``.

    Args:
        path: folder to replace; it need not exist.
        new: folder with the new files, beside ``path``.
        owned: relative paths of this program's files, as for ``atomic_folder``.

    Raises:
        OSError: the folder cannot be written.
    """
    if path.exists():
        _keep_others(path, new, owned)
        aside = Path(
            tempfile.mkdtemp(prefix=TEMPORARY_PREFIX, suffix=ASIDE_SUFFIX, dir=path.parent)
        )
        path.replace(aside / path.name)
        new.replace(path)
        shutil.rmtree(aside)
    else:
        new.replace(path)


def _keep_others(old: Path, new: Path, owned: Collection[str]) -> None:
    """Link the files of ``old`` that are neither in ``new`` nor in ``owned`` into ``new``."""
    for path in sorted(old.rglob("*")):
        name = path.relative_to(old).as_posix()
        kept = new / name
        if os.path.lexists(kept) or name in owned:
            continue
        if path.is_dir() and not path.is_symlink():
            if not any(path.iterdir()):
                kept.mkdir(parents=True)
            continue
        kept.parent.mkdir(parents=True, exist_ok=True)
        link_or_copy(path, kept)


def link_or_copy(old: Path, new: Path) -> None:
    """Make a hard link to a file, or a copy where the file system has no hard links.

    Raises:
        OSError: the folder cannot be written.
    """
    try:
        os.link(old, new, follow_symlinks=False)
    except OSError:
        shutil.copy2(old, new, follow_symlinks=False)


def remove_owned(folder: Path, owned: Collection[str]) -> None:
    """Remove the files of a folder that this program wrote, and the folders that become empty.

    These are the files of ``owned`` (as for ``atomic_folder``) and temporary ones.
    """
    if folder.is_symlink() or not folder.is_dir():
        return
    held = {str(parent) for name in owned for parent in PurePosixPath(name).parents}
    for path in sorted(folder.rglob("*"), reverse=True):
        name = path.relative_to(folder).as_posix()
        ours = any(map(is_temporary, name.split("/")))
        if path.is_dir() and not path.is_symlink():
            if ours or name in held:
                with suppress(OSError):  # the folder is not empty
                    path.rmdir()
        elif ours or name in owned:
            path.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


def _require_room(path: Path, folder: Path, error: RuntimeError) -> None:
    """Say that a disk is full where it is: libraries report it in many different ways.

    Raises:
        WriteError: the disk of ``folder`` is full, which the error is taken to come from.
    """
    if shutil.disk_usage(folder).free < _FULL_BYTES:
        raise WriteError(f"cannot write {path}: the disk is full") from error


def _reason(error: OSError, partial: Path | None) -> str:
    """Return what went wrong, with the name of the file if it is not the one being written.

    An error of copying names the file that is read, although it is the other disk that is full.
    """
    reason = error.strerror or str(error)
    named = None if error.errno in (errno.ENOSPC, errno.EDQUOT) else error.filename
    if partial is None or named is None or Path(str(named)).is_relative_to(partial):
        return reason
    return f"{named}: {reason}"


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
