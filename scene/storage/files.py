"""Files that are either whole or absent, and their digests.

Temporary files and folders have names of ours, ``.objconnect-????????.partial`` and the like. No
other file is ever removed: a folder that is replaced keeps what we did not write.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any, Final

from filelock import FileLock, Timeout

from scene.errors import InputError, WriteError

# Every temporary name begins so; see ``is_ours``.
MARK: Final = ".objconnect-"
PARTIAL = ".partial"
# Holds a folder that is being replaced: after a kill it is the only copy.
_ASIDE = ".aside"
_TEMPORARY = re.compile(rf"{re.escape(MARK)}[a-z0-9_]{{8}}({PARTIAL}|{_ASIDE})")
_LOCK = f"{MARK}lock"
# Bytes of a name, in every usual file system.
_LONGEST = 255
# A disk with less left is full.
_FULL = 1 << 20
# A text is read whole: more than this is none that a person or a program of ours wrote (B).
_LONGEST_TEXT = 1 << 30


def require_readable(path: Path, what: str) -> None:
    """Refuse what is no regular file, before it is opened: a pipe waits for somebody to write, and
    a device may have no end. A symbolic link counts as what it leads to.

    Args:
        path: to be read.
        what: it is, for the message.

    Raises:
        InputError: it is missing, a folder, a device, a pipe or a socket, or lies where this user
            may not look.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else None
        raise InputError(f"cannot read {what} {path}: {reason or error}") from None
    if stat.S_ISDIR(mode):
        raise InputError(f"cannot read {what} {path}: {os.strerror(errno.EISDIR)}")
    if not stat.S_ISREG(mode):
        raise InputError(f"cannot read {what} {path}: it is a device or a pipe, not a file")


def sha256_of(path: Path) -> str:
    """Hex digest of a file's bytes.

    Raises:
        InputError: it is no regular file, see ``require_readable``.
        OSError: it cannot be read.
    """
    require_readable(path, "file")
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def inside(name: str) -> bool:
    """Whether a path in a list of files, which says where in their folder they are, stays there,
    and a file can have it."""
    parts = name.split("/")
    short = all(len(part.encode("utf-8", "surrogatepass")) <= _LONGEST for part in parts)
    return short and "\0" not in name and not name.startswith("/") and ".." not in parts


def is_ours(name: str) -> bool:
    """Whether a file or folder of this name is a temporary one of ours."""
    return name.startswith(MARK)


def require_regular(path: Path) -> None:
    """Refuse to write where something stands that a file must not replace.

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
def written_whole(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place only when the block succeeds.

    Raises:
        WriteError: the folder cannot be written, the disk is full, or something that is no regular
            file stands there.
    """
    partial: Path | None = None
    try:
        require_regular(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=MARK, suffix=PARTIAL, dir=path.parent)
        os.close(handle)
        partial = Path(name)
        # mkstemp makes private files; a result should be as readable as any other file.
        partial.chmod(0o666 & ~_umask())
        yield partial
        partial.replace(path)
    except WriteError:
        raise
    except OSError as error:
        raise WriteError(f"cannot write {path}: {_reason(error, partial)}") from error
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
    ``folder``; a folder that was being replaced when its process died is put back."""
    for path in [found for found in folder.rglob(f"{MARK}*") if _TEMPORARY.fullmatch(found.name)]:
        if path.name.endswith(_ASIDE):
            for old in list(path.iterdir()):
                if not os.path.lexists(path.parent / old.name):
                    old.replace(path.parent / old.name)
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


@contextmanager
def folder_written_whole(path: Path, owned: Collection[str] = ()) -> Iterator[Path]:
    """The same for a folder: ``path`` is replaced only when the block succeeds.

    Files of the old folder that the block did not write again stay, but for ``owned``.

    Args:
        path: of the folder; where it is a symbolic link, the folder it leads to is replaced.
        owned: paths, relative to the folder, of the files that we write there. Those of the old
            folder that are not written again go.

    Raises:
        InputError: the parent folder cannot be written, or the disk is full.
    """
    partial: Path | None = None
    try:
        path = path.resolve()
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=MARK, suffix=PARTIAL, dir=path.parent))
        partial.chmod(0o777 & ~_umask())
        yield partial
        replace_folder(path, partial, owned)
    except WriteError:
        raise
    except OSError as error:
        raise WriteError(f"cannot write {path}: {_reason(error, partial)}") from error
    finally:
        if partial is not None:
            shutil.rmtree(partial, ignore_errors=True)


def _reason(error: OSError, partial: Path | None) -> str:
    """What went wrong, and with which file where it is not in what is being written."""
    reason = error.strerror or str(error)
    named = error.filename
    if partial is None or named is None or Path(str(named)).is_relative_to(partial):
        return reason
    return f"{named}: {reason}"


def replace_folder(path: Path, new: Path, owned: Collection[str]) -> None:
    """Put the folder ``new`` in the place of ``path``, with what ``path`` holds and we did not
    write: every file that ``new`` does not have and that is not ``owned`` (as of
    ``folder_written_whole``).

    Args:
        path: of the folder; there may be none.
        new: beside it.
        owned: paths of our files.

    Raises:
        OSError: the folder cannot be written.
    """
    if path.exists():
        _keep_others(path, new, owned)
        aside = Path(tempfile.mkdtemp(prefix=MARK, suffix=_ASIDE, dir=path.parent))
        path.replace(aside / path.name)
        new.replace(path)
        shutil.rmtree(aside)
    else:
        new.replace(path)


def _keep_others(old: Path, new: Path, owned: Collection[str]) -> None:
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
    """A second name for a file; a copy, where the file system knows no hard links.

    Raises:
        OSError: the folder cannot be written.
    """
    try:
        os.link(old, new, follow_symlinks=False)
    except OSError:
        shutil.copy2(old, new, follow_symlinks=False)


def remove_owned(folder: Path, owned: Collection[str]) -> None:
    """Remove the files of a folder that are ``owned`` (as of ``folder_written_whole``), our
    temporary ones, and the folders that held them, itself included, unless they hold more."""
    if folder.is_symlink() or not folder.is_dir():
        return
    held = {str(parent) for name in owned for parent in PurePosixPath(name).parents}
    for path in sorted(folder.rglob("*"), reverse=True):
        name = path.relative_to(folder).as_posix()
        ours = any(map(is_ours, name.split("/")))
        if path.is_dir() and not path.is_symlink():
            if ours or name in held:
                with suppress(OSError):  # it holds something
                    path.rmdir()
        elif ours or name in owned:
            path.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


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


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Keep others that ask for it out of a folder during the block.

    The lock is the system's, on a file of ours in the folder: it ends with the process, however
    that ends. The file goes with the block, and so does a folder that was not there and stayed
    empty.

    Raises:
        InputError: another process has it, or the folder cannot be made or written.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise WriteError(f"cannot write {folder}: {error.strerror or error}") from None
        with locked(folder / _LOCK, folder):
            yield
    finally:
        with suppress(OSError):  # not empty, which is as it should be
            for path in made:
                path.rmdir()


@contextmanager
def locked(lock: Path, what: Path) -> Iterator[None]:
    """Hold a lock file during the block; it is gone afterwards.

    Args:
        lock: the file; its folder exists.
        what: that it guards, for the message.

    Raises:
        InputError: another process holds it, or it cannot be made.
    """
    held = FileLock(lock, blocking=False, thread_local=False)
    try:
        held.acquire()
    except Timeout:
        raise InputError(f"another run is writing {what}: wait for it to end") from None
    except (OSError, NotImplementedError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise WriteError(f"cannot write {what}: {reason or error}") from None
    try:
        yield
    finally:
        # While it is held: who opened it before finds it unlinked, and asks anew. Windows keeps it.
        with suppress(OSError):
            lock.unlink()
        held.release()


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
    """Read a text file of at most 1 GiB.

    Raises:
        InputError: ``what`` is missing, no regular file, unreadable, larger, or not UTF-8.
    """
    require_readable(path, what)
    try:
        if path.stat().st_size > _LONGEST_TEXT:
            raise InputError(
                f"cannot read {what} {path}: it is larger than {_LONGEST_TEXT >> 30} GiB"
            )
        # Windows programs begin a text with a mark of the order of its bytes.
        return path.read_text(encoding="utf-8-sig")
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
