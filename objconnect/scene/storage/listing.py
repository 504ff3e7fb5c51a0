"""The files of a folder that belong to the user."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final

from objconnect.scene.errors import InputError

PHOTOGRAPHS: Final = (".jpg", ".jpeg", ".png")
"""The suffixes of the photographs that are read, in lower case."""

# Names that file managers leave behind, besides hidden files.
_LEFT_BEHIND: Final = frozenset({"thumbs.db", "desktop.ini", "__macosx"})


def is_stray(name: str) -> bool:
    """Return whether a file or folder belongs to a file manager or a running program, not to the
    user.

    These are hidden ones, such as ``.DS_Store`` and macOS's ``._a.jpg``, and Windows'
    ``Thumbs.db``.
    """
    return name.startswith(".") or name.lower() in _LEFT_BEHIND


def list_files(folder: Path, endings: Collection[str], depth: int | None = 1) -> list[Path]:
    """Return the files below a folder with one of the given suffixes, sorted, without stray files.

    Pipes and devices are included: the reader of a file reports them.

    Args:
        folder: folder to search.
        endings: suffixes in lower case, with the dot; those of the files may be of any case.
        depth: number of folder levels, 1 for the folder itself; None for all, without following
            links to folders.

    Raises:
        InputError: the folder, or one in it, does not exist or cannot be listed.
    """
    return sorted(_files(folder, frozenset(endings), depth))


def _is_folder(entry: os.DirEntry[str], follow_symlinks: bool) -> bool:
    try:
        return entry.is_dir(follow_symlinks=follow_symlinks)
    except OSError:  # a symbolic link to itself
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
