"""Checked reads: what may be opened, text, JSON and names of files."""

from __future__ import annotations

import errno
import json
import os
import shutil
import stat
from pathlib import Path
from typing import Any

from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.storage.packed import SUFFIX, unpack

# The longest file name that every usual file system allows (bytes).
_MAX_NAME_BYTES = 255
# A text is read whole; a larger one was written by no person and by no program of ours (bytes).
_LONGEST_TEXT = 1 << 30


def require_readable(path: Path, what: str) -> None:
    """Refuse to open anything but a regular file; a symbolic link counts as what it leads to.

    Reading a pipe waits for somebody to write into it, and reading a device may never end.

    Args:
        path: file to read.
        what: what the file is, for the message.

    Raises:
        InputError: the path is missing, a folder, a device, a pipe or a socket, or lies where this
            user may not look.
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


def read_text(path: Path, what: str) -> str:
    """Read a UTF-8 text file of at most 1 GiB, or one that xz compressed, ``NAME.xz``.

    Args:
        path: file to read.
        what: what the file is, for the message.

    Raises:
        InputError: the file is missing, not a regular file, unreadable, larger, not UTF-8, or not
            compressed as its name says.
    """
    require_readable(path, what)
    try:
        if path.stat().st_size > _LONGEST_TEXT:
            raise InputError(
                f"cannot read {what} {path}: it is larger than {_LONGEST_TEXT >> 30} GiB"
            )
        # Programs on Windows begin a UTF-8 text with a byte order mark.
        if path.suffix == SUFFIX:
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

    Example:
        >>> parse_json('{"seed": 3}')
        {'seed': 3}
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def is_safe_path(name: str) -> bool:
    """Return whether a relative path stays inside its folder and is a possible file name.

    Lists of files say with such paths where each file lies in their folder.

    Example:
        >>> [is_safe_path(name) for name in ("grid/images/1.jpg", "../1.jpg", "/etc/passwd")]
        [True, False, False]
    """
    parts = name.split("/")
    short = all(len(part.encode("utf-8", "surrogatepass")) <= _MAX_NAME_BYTES for part in parts)
    return short and "\0" not in name and not name.startswith("/") and ".." not in parts


def require_disk_space(path: Path, needed: int) -> None:
    """Refuse to write more than the disk has space for.

    It is for writers that crash or write a damaged file on a full disk.

    Args:
        path: file or folder to write, in a folder that exists.
        needed: bytes.

    Raises:
        WriteError: there is less space.
    """
    free = shutil.disk_usage(path.parent).free
    if free < needed:
        raise WriteError(
            f"cannot write {path}: the disk has {free / 1e6:.0f} MB left and {needed / 1e6:.0f} MB "
            "are needed: free some and run again"
        )
