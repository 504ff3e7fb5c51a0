"""The cache of a map: files of arrays, named by digests of their inputs.

The inputs are the map, the bytes of its photographs, the method's options and its weights, so that
a file that was made from other inputs is never used. Each row of a file, usually one per
photograph, has a digest of its inputs too. When photographs are added to a map, a new file is
written, and unchanged rows are copied from earlier files.
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

# Number of hexadecimal digits of a digest in the name of a file.
_DIGITS: Final = 16
# Maximum number of earlier files that are open at once, because a cache may hold more files than a
# process may open.
_MAX_OPEN: Final = 8


class EarlierRows:
    """Rows of existing cache files of one kind, of any map.

    Args:
        paths: paths of the files; damaged ones are skipped.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        self._open = lru_cache(maxsize=_MAX_OPEN)(Store)
        self._rows: dict[str, tuple[Path, int]] = {}
        for path in paths:
            with suppress(InputError):
                rows = self._open(path).rows
                self._rows |= {key: (path, row) for key, row in rows.items()}

    def __call__(self, key: str, names: Iterable[str]) -> dict[str, NDArray[Any]] | None:
        """Return the named arrays of the row with a key; None if no file has the row."""
        if key in self._rows:
            path, row = self._rows[key]
            with suppress(InputError):
                return self._open(path).arrays(row, names)
        return None


@dataclass(frozen=True)
class MapCache:
    """The cache of a map, with the map and its photographs.

    Attributes:
        sparse_map: the map.
        images: folder of the photographs.
        folder: folder of the cache.
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
        """Return the cache of a map in a folder, after reading the map's photographs.

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

    def holds(self, kind: str, *inputs: object) -> bool:
        """Return whether there is a file of all photographs; arguments are those of ``store``."""
        return self.whole._path(kind, inputs).is_file()

    def store(self, kind: str, *inputs: object, rows: Callable[[EarlierRows], Rows]) -> Store:
        """Return a file of a kind, which is written if it does not exist.

        Two processes may write it at the same time; both write the same complete file.

        Args:
            kind: kind of content, the prefix of the file's name.
            inputs: inputs of the content in addition to the map and its photographs.
            rows: computes the rows of the file; it receives the rows of existing files of the kind.

        Raises:
            InputError: the file is damaged, or a photograph changed since it was read.
            WriteError: the folder cannot be written, or the disk is full.
        """
        path = self._path(kind, inputs)

        def check_rows() -> Rows:
            yield from rows(self.earlier(kind))
            files = [self.images / name for name in self.digests]
            require_unchanged(files, list(self.digests.values()))

        if not path.is_file():
            write_store(path, check_rows())
        return Store(path)

    def earlier(self, kind: str) -> EarlierRows:
        """Return the rows of existing files of a kind, in the folder and its parts' subfolders."""
        name = f"{kind}-{'[0-9a-f]' * _DIGITS}.h5"
        return EarlierRows(sorted([*self.folder.glob(name), *self.folder.glob(f"*/{name}")]))

    def _path(self, kind: str, inputs: Iterable[object]) -> Path:
        parts = (self.sparse_map.sha256, *self.digests.values(), *inputs)
        folder = self.folder
        if self.part is not None:
            folder, parts = self.part.folder, (*parts, *self.names)
        return folder / f"{kind}-{digest_of(kind, *parts)[:_DIGITS]}.h5"


@contextmanager
def open_cache(sparse_map: SparseMap, images: Path, folder: Path | None) -> Iterator[MapCache]:
    """Yield the cache of a map in a folder, or in a temporary one that is removed afterwards.

    Stores that were opened stay readable after the removal. Errors are those of ``MapCache.of``.
    """
    with cache_or_scratch(folder, None) as cache_folder:
        yield MapCache.of(sparse_map, images, cache_folder)
