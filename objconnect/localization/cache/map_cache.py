"""The cache of a map: files of arrays, named by digests of their inputs.

The inputs are the map, the bytes of its photographs, the method's options and its weights, so a
file of other inputs is never used. Each row has a digest of its inputs, too. When photographs are
added to a map, a new file is written and unchanged rows are copied.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray

from objconnect.localization.cache.store import Rows, Store, write_store
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import MapPart
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.digests import digest_of, digests_in, require_unchanged
from objconnect.scene.storage.images import check_photographs
from objconnect.scene.storage.scratch import cache_or_scratch

_DIGITS: Final = 16
# Maximum number of earlier files that are open: a cache may hold more than a process may open.
_OPEN: Final = 8


class Earlier:
    """Rows of earlier files of a kind, whatever their map.

    Args:
        paths: paths of the files; damaged ones are skipped.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        self._open = lru_cache(maxsize=_OPEN)(Store)
        self._rows: dict[str, tuple[Path, int]] = {}
        for path in paths:
            with suppress(InputError):
                rows = self._open(path).rows
                self._rows |= {key: (path, row) for key, row in rows.items()}

    def __call__(self, key: str, names: Iterable[str]) -> dict[str, NDArray[Any]] | None:
        """Return arrays of the row with a key; None if no file has it."""
        if key in self._rows:
            path, row = self._rows[key]
            with suppress(InputError):
                return self._open(path).arrays(row, names)
        return None


@dataclass(frozen=True)
class MapCache:
    """The cache of a map, with the map and its photographs.

    Attributes:
        digests: digests of the photographs by name, in the order of ``SparseMap.names``.
        part: the photographs that are prepared; None for all.
    """

    sparse_map: SparseMap
    images: Path
    folder: Path
    digests: Mapping[str, str]
    part: MapPart | None = None

    @staticmethod
    def of(
        sparse_map: SparseMap, images: Path, folder: Path, part: MapPart | None = None
    ) -> MapCache:
        """Read a map's photographs.

        Raises:
            InputError: a photograph is missing, broken or not of its camera's size.
        """
        names = sparse_map.names
        check_photographs(images, {name: sparse_map.images[name].camera for name in names})
        return MapCache(sparse_map, images, folder, digests_in(images, names), part)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the photographs that are prepared."""
        return self.sparse_map.names if self.part is None else tuple(self.part.names)

    @property
    def whole(self) -> MapCache:
        """Return the cache of all photographs."""
        return replace(self, part=None)

    def holds(self, kind: str, *made_of: object) -> bool:
        """Return whether there is a file of all photographs; arguments are those of ``store``."""
        return self.whole._path(kind, made_of).is_file()

    def store(self, kind: str, *made_of: object, rows: Callable[[Earlier], Rows]) -> Store:
        """Return a file of a kind, which is written if it does not exist.

        Two processes may write it at the same time; both write the same complete file.

        Args:
            kind: prefix of its name.
            made_of: further inputs of its content beside the photographs and the map.
            rows: computes its rows; it receives the rows of earlier files of the kind.

        Raises:
            InputError: the file is damaged, or a photograph changed since it was read.
            WriteError: the folder cannot be written, or the disk is full.
        """
        path = self._path(kind, made_of)

        def cached_rows() -> Rows:
            yield from rows(self.earlier(kind))
            files = [self.images / name for name in self.digests]
            require_unchanged(files, list(self.digests.values()))

        if not path.is_file():
            write_store(path, cached_rows())
        return Store(path)

    def earlier(self, kind: str) -> Earlier:
        """Return the rows of a kind in the folder and in its subfolders with parts."""
        name = f"{kind}-{'[0-9a-f]' * _DIGITS}.h5"
        return Earlier(sorted([*self.folder.glob(name), *self.folder.glob(f"*/{name}")]))

    def _path(self, kind: str, made_of: Iterable[object]) -> Path:
        parts = (self.sparse_map.sha256, *self.digests.values(), *made_of)
        folder = self.folder
        if self.part is not None:
            folder, parts = self.part.folder, (*parts, *self.names)
        return folder / f"{kind}-{digest_of(kind, *parts)[:_DIGITS]}.h5"


@contextmanager
def open_cache(sparse_map: SparseMap, images: Path, folder: Path | None) -> Iterator[MapCache]:
    """Yield the cache of a map in a folder, or in a temporary one that is removed afterwards.

    Files that were opened in it stay open. Errors are those of ``MapCache.of``.
    """
    with cache_or_scratch(folder, None) as kept:
        yield MapCache.of(sparse_map, images, kept)
