"""Atomic writes: a file or folder is either whole or absent.

Data is first written under a temporary name such as ``.objconnect-????????.partial``. A folder that
is replaced keeps the files of other programs.
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
from threading import Lock
from typing import Final

from objconnect.scene.errors import WriteError

TEMPORARY_PREFIX: Final = ".objconnect-"
"""Prefix of every temporary name; see ``is_temporary``."""
PARTIAL_SUFFIX: Final = ".partial"
"""Suffix of a file or folder that is being written."""

ASIDE_SUFFIX: Final = ".aside"
"""Suffix of a folder that holds the old version of a folder that is being replaced. If the process
is killed, this may be the only copy."""

# A disk with less free space (bytes) is treated as full.
_FULL_BYTES = 1 << 20
# The mask is read by setting it: two threads at once would leave it at zero.
_UMASK_LOCK: Final = Lock()


def is_temporary(name: str) -> bool:
    """Return whether a file or folder of this name is a temporary one of this program."""
    return name.startswith(TEMPORARY_PREFIX)


def require_regular(path: Path) -> None:
    """Refuse to replace anything but a regular file.

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
def atomic_write(path: Path, parent: Path | None = None) -> Iterator[Path]:
    """Write a file atomically: yield a temporary path that becomes ``path`` if the block succeeds.

    Args:
        path: file to write.
        parent: folder of the temporary path, on the same disk; None for the folder of the file.

    Raises:
        WriteError: the folder cannot be written, the disk is full, or ``path`` is not a regular
            file.

    Examples:
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
            prefix=TEMPORARY_PREFIX, suffix=PARTIAL_SUFFIX, dir=parent or path.parent
        )
        os.close(handle)
        partial = Path(name)
        # mkstemp makes files private; results get the default permissions.
        partial.chmod(0o666 & ~_umask())
        yield partial
        partial.replace(path)
    except WriteError:
        raise
    except OSError as error:
        raise WriteError(f"cannot write {path}: {_reason(error, partial)}") from error
    except RuntimeError as error:
        _require_free_space(path, path.parent, error)
        raise
    finally:
        if partial is not None:
            partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file atomically.

    Raises:
        InputError: the file cannot be written; see ``atomic_write``.
    """
    with atomic_write(path) as partial:
        partial.write_text(text, encoding="utf-8")


@contextmanager
def atomic_folder(path: Path, owned: Collection[str] = ()) -> Iterator[Path]:
    """Write a folder atomically: yield a temporary folder that becomes ``path`` on success.

    Files of the old folder are kept unless the block writes them again or ``owned`` lists them.

    Args:
        path: folder to write; if it is a symbolic link, its target is replaced.
        owned: relative paths of all files that this program may write there.

    Raises:
        InputError: the parent folder cannot be written, or the disk is full.
    """
    partial: Path | None = None
    given_path = path
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
        # The message names the final path instead of the temporary one.
        raise WriteError(str(error).replace(str(partial), str(given_path))) from error
    except OSError as error:
        raise WriteError(f"cannot write {given_path}: {_reason(error, partial)}") from error
    except RuntimeError as error:
        if partial is not None:
            _require_free_space(given_path, path.parent, error)
        raise
    finally:
        if partial is not None:
            shutil.rmtree(partial, ignore_errors=True)


def replace_folder(path: Path, new: Path, owned: Collection[str]) -> None:
    """Replace the folder ``path`` by ``new``, and keep the files of other programs.

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
    """Link into ``new`` the files of ``old`` that are neither in ``new`` nor in ``owned``."""
    for path in sorted(old.rglob("*")):
        name = path.relative_to(old).as_posix()
        target = new / name
        if os.path.lexists(target) or name in owned:
            continue
        if path.is_dir() and not path.is_symlink():
            if not any(path.iterdir()):
                target.mkdir(parents=True)
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        link_or_copy(path, target)


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
    """Remove this program's files from a folder, and the folders that become empty.

    These are the files of ``owned`` (as for ``atomic_folder``) and temporary ones.
    """
    if folder.is_symlink() or not folder.is_dir():
        return
    owned_folders = {str(parent) for name in owned for parent in PurePosixPath(name).parents}
    for path in sorted(folder.rglob("*"), reverse=True):
        name = path.relative_to(folder).as_posix()
        ours = any(map(is_temporary, name.split("/")))
        if path.is_dir() and not path.is_symlink():
            if ours or name in owned_folders:
                with suppress(OSError):  # the folder is not empty
                    path.rmdir()
        elif ours or name in owned:
            path.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


def _require_free_space(path: Path, folder: Path, error: RuntimeError) -> None:
    """Raise WriteError if the disk of ``folder`` is full, whatever error a library reports.

    Raises:
        WriteError: the disk is full.
    """
    if shutil.disk_usage(folder).free < _FULL_BYTES:
        raise WriteError(f"cannot write {path}: the disk is full") from error


def _reason(error: OSError, partial: Path | None) -> str:
    """Return the reason of an error, with the file name if another file is concerned."""
    reason = error.strerror or str(error)
    # On a full disk an error of copying names the file that was read.
    named_file = None if error.errno in (errno.ENOSPC, errno.EDQUOT) else error.filename
    if partial is None or named_file is None or Path(str(named_file)).is_relative_to(partial):
        return reason
    return f"{named_file}: {reason}"


def _umask() -> int:
    with _UMASK_LOCK:
        current = os.umask(0)
        os.umask(current)
    return current
