"""What earlier files of a cache hold of photographs, by a digest of all that it was made of."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Final, Generic, TypeVar

import numpy as np

from objconnect.scene.errors import InputError

# Earlier files that are open at a time: a cache may hold more than a process may open.
_OPEN: Final = 8

FileT = TypeVar("FileT")
RowT = TypeVar("RowT")
T = TypeVar("T")


def key_of(*parts: object) -> str:
    """Return a digest of all that something was made of: of the bytes of arrays, else of text."""
    sha256 = hashlib.sha256()
    for part in parts:
        array = isinstance(part, np.ndarray)
        data = np.ascontiguousarray(part).tobytes() if array else str(part).encode()
        sha256.update(f"{len(data)} ".encode() + data)
    return sha256.hexdigest()


def kept_files(cache: Path, prefix: str) -> list[Path]:
    """Return the files of a prefix in a cache, and in its folders, where processes leave parts."""
    return sorted([*cache.glob(f"{prefix}-*.h5"), *cache.glob(f"*/{prefix}-*.h5")])


class Earlier(Generic[FileT, RowT]):
    """What earlier files hold of photographs.

    Where photographs are added to a map, a file is written anew, as one file holds what is known
    of all. What the change does not touch is copied from here.

    Args:
        open_file: opens a file.
        by_key: returns the rows of a file, or the names, by their keys.
        paths: of the files; damaged and other files are passed over.
    """

    def __init__(
        self,
        open_file: Callable[[Path], FileT],
        by_key: Callable[[FileT], Mapping[str, RowT]],
        paths: Iterable[Path],
    ) -> None:
        self._file = lru_cache(maxsize=_OPEN)(open_file)
        self._found: dict[str, tuple[Path, RowT]] = {}
        for path in paths:
            with suppress(InputError):
                rows = by_key(self._file(path))
                self._found |= {key: (path, row) for key, row in rows.items()}

    def read(self, key: str, read: Callable[[FileT, RowT], T]) -> T | None:
        """Return what ``read`` returns of the row with a key; None where no file holds it."""
        if key not in self._found:
            return None
        path, row = self._found[key]
        with suppress(InputError):
            return read(self._file(path), row)
        return None
