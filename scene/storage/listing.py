"""What lies in a folder, for those who look through it."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final

from scene.errors import InputError

PHOTOGRAPHS: Final = (".jpg", ".jpeg", ".png")
"""Endings of the photographs that are read, in small letters."""

# What file managers leave, besides hidden files.
_LEFT_BEHIND: Final = frozenset({"thumbs.db", "desktop.ini", "__macosx"})


def is_stray(name: str) -> bool:
    """Whether a file or folder belongs to a file manager or to a running program, not to the user:
    hidden ones, such as ``.DS_Store`` and macOS's ``._a.jpg``, and Windows' ``Thumbs.db``."""
    return name.startswith(".") or name.lower() in _LEFT_BEHIND


def files_in(folder: Path, endings: Collection[str], depth: int | None = 1) -> list[Path]:
    """Files below a folder by their endings, sorted; strays are left out.

    A pipe or a device is among them: who reads it says that it is none.

    Args:
        folder: to look through.
        endings: in small letters, with the dot; those of the files may be of any case.
        depth: how many folders deep, 1 for the folder itself; None for all, without links to
            folders.

    Raises:
        InputError: the folder, or one in it, does not exist or cannot be looked through.
    """
    return sorted(_files(folder, frozenset(endings), depth))


def _is_folder(entry: os.DirEntry[str], follow_symlinks: bool) -> bool:
    try:
        return entry.is_dir(follow_symlinks=follow_symlinks)
    except OSError:  # a link that leads to itself
        return False


def _files(folder: Path, endings: frozenset[str], depth: int | None) -> Iterator[Path]:
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if is_stray(entry.name):
                    continue
                path = folder / entry.name
                if _is_folder(entry, follow_symlinks=depth is not None):
                    if depth is None or depth > 1:
                        yield from _files(path, endings, depth and depth - 1)
                elif path.suffix.lower() in endings:
                    yield path
    except OSError as error:
        raise InputError(f"cannot look through {folder}: {error.strerror}") from None
