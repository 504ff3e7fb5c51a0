"""Checked reads of files, text and JSON; safe paths and free disk space."""

from __future__ import annotations

import errno
import json
import os
import shutil
import stat
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.storage.packed import XZ_SUFFIX, unpack

# Longest file name that every common file system allows (bytes).
_MAX_NAME_BYTES = 255
# Largest text file that is read (bytes), because it is read into memory whole.
_LONGEST_TEXT = 1 << 30


def require_readable(path: Path, what: str) -> None:
    """Refuse to open anything but a regular file or a link to one.

    Reading a pipe waits for a writer, and reading a device may never end.

    Args:
        path: file to read.
        what: noun for the file in the message.

    Raises:
        InputError: the path is missing, not accessible, a folder, a device, a pipe or a socket.
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


def require_folder(path: Path, what: str) -> None:
    """Refuse a path that is missing or is not a folder.

    Args:
        path: folder to read.
        what: noun for the folder in the message.

    Raises:
        InputError: the path is missing, or a file lies there.
    """
    if not path.is_dir():
        wrong = "is not a folder" if os.path.lexists(path) else "does not exist"
        raise InputError(f"{what} {path} {wrong}: check the path")


def require_distinct(paths: Iterable[Path]) -> None:
    """Refuse a file or folder that is given twice, even through a symbolic link.

    Raises:
        InputError: a path is given twice.
    """
    for path, count in Counter(path.resolve() for path in paths).items():
        if count > 1:
            raise InputError(f"{path} is given {count} times: give it once")


def read_text(path: Path, what: str) -> str:
    """Read a UTF-8 text file of at most 1 GiB; ``NAME.xz`` is decompressed.

    Args:
        path: file to read.
        what: noun for the file in the message.

    Raises:
        InputError: the file is missing, not a regular file, unreadable, larger, not UTF-8, or not
            a valid xz file.
    """
    require_readable(path, what)
    try:
        if path.stat().st_size > _LONGEST_TEXT:
            raise InputError(
                f"cannot read {what} {path}: it is larger than {_LONGEST_TEXT >> 30} GiB"
            )
        # Programs on Windows begin a UTF-8 text with a byte order mark.
        if path.suffix == XZ_SUFFIX:
            return unpack(path.read_bytes()).decode("utf-8-sig")
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not a UTF-8 text file"
        raise InputError(f"cannot read {what} {path}: {reason}") from error
    except ValueError as error:
        raise InputError(f"cannot read {what} {path}: {error}") from None


def parse_json(text: str) -> Any:
    """Parse JSON of unknown origin.

    Raises:
        ValueError: the text is not JSON, or is nested thousands of levels deep.

    Examples:
        >>> parse_json('{"seed": 3}')
        {'seed': 3}
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def is_safe_path(name: str) -> bool:
    """Return whether a path is relative, stays inside its folder and is a valid file name.

    Examples:
        >>> [is_safe_path(name) for name in ("grid/images/1.jpg", "../1.jpg", "/etc/passwd")]
        [True, False, False]
    """
    parts = name.split("/")
    short = all(len(part.encode("utf-8", "surrogatepass")) <= _MAX_NAME_BYTES for part in parts)
    return short and "\0" not in name and not name.startswith("/") and ".." not in parts


def require_disk_space(path: Path, needed: int) -> None:
    """Check the free disk space, for writers that crash or write damaged files on a full disk.

    Args:
        path: file or folder to write, in an existing folder.
        needed: bytes.

    Raises:
        WriteError: there is less space.
    """
    free = shutil.disk_usage(path.parent).free
    if free < needed:
        raise WriteError(
            f"cannot write {path}: the disk has {free / 1e6:.0f} MB left and {needed / 1e6:.0f} MB "
            "are needed: free some space and run again"
        )
