"""Listing of input files, without hidden and system files."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final

from objconnect.scene.errors import InputError

PHOTOGRAPHS: Final = (".jpg", ".jpeg", ".png")
"""Suffixes of photographs, in lower case."""
OTHER_PICTURES: Final = (
    *(".tif", ".tiff", ".webp", ".heic", ".heif", ".avif", ".bmp", ".gif", ".jp2"),
    *(".dng", ".raw", ".arw", ".cr2", ".cr3", ".nef", ".orf", ".raf", ".rw2"),
)
"""Suffixes of pictures that are not read as photographs, in lower case."""

# Files and folders that file managers create, besides hidden ones.
_FILE_MANAGER_NAMES: Final = frozenset({"thumbs.db", "desktop.ini", "__macosx"})


def is_stray(name: str) -> bool:
    """Return whether a file or folder of this name is hidden or made by a file manager.

    Examples are ``.DS_Store``, ``._a.jpg`` and ``Thumbs.db``.
    """
    return name.startswith(".") or name.lower() in _FILE_MANAGER_NAMES


def list_files(folder: Path, suffixes: Collection[str], depth: int | None = 1) -> list[Path]:
    """Return the files below a folder with one of the given suffixes, sorted, without stray files.

    Pipes and devices are included: the reader of a file reports them.

    Args:
        folder: folder to search.
        suffixes: suffixes in lower case with the dot; files may have them in any case.
        depth: number of folder levels, 1 for the folder itself; None for all, without following
            links to folders.

    Raises:
        InputError: the folder, or one in it, does not exist or cannot be listed.
    """
    return sorted(_files(folder, frozenset(suffixes), depth))


def _is_folder(entry: os.DirEntry[str], follow_symlinks: bool) -> bool:
    try:
        return entry.is_dir(follow_symlinks=follow_symlinks)
    except OSError:  # a symbolic link to itself
        return False


def _files(folder: Path, suffixes: frozenset[str], depth: int | None) -> Iterator[Path]:
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if is_stray(entry.name):
                    continue
                path = folder / entry.name
                if _is_folder(entry, follow_symlinks=depth is not None):
                    if depth is None or depth > 1:
                        yield from _files(path, suffixes, depth and depth - 1)
                elif path.suffix.lower() in suffixes:
                    yield path
    except OSError as error:
        raise InputError(f"cannot list the folder {folder}: {error.strerror}") from None
