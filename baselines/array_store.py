"""A file of arrays of all photographs of a map, from which those of a photograph can be read."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, Protocol

import h5py
import numpy as np
from numpy.typing import NDArray

from scene.errors import HDF5_DAMAGE, InputError
from scene.storage.atomic import atomic_write
from scene.storage.files import require_readable
from scene.storage.hdf5 import array, attribute, dataset

# Earlier files that are open at a time.
_OPEN: Final = 8

Arrays = Mapping[str, NDArray[Any]]
"""Arrays of one photograph, by name; all have the same number of rows."""


class Add(Protocol):
    """Adds the arrays of the next photograph to a file."""

    def __call__(self, parts: Arrays, key: str = "") -> None:
        """Add arrays; ``key`` says what they were made of, as ``key_of`` returns it."""
        ...


def key_of(*parts: object) -> str:
    """Return a digest of all that something was made of: of the bytes of arrays, else of text."""
    sha256 = hashlib.sha256()
    for part in parts:
        array = isinstance(part, np.ndarray)
        data = np.ascontiguousarray(part).tobytes() if array else str(part).encode()
        sha256.update(f"{len(data)} ".encode() + data)
    return sha256.hexdigest()


@contextmanager
def written_store(path: Path, **attributes: float) -> Iterator[Add]:
    """Write a file of arrays; yield a function that adds the arrays of the next photograph.

    The file appears only when it is complete.

    Raises:
        InputError: the folder cannot be written.
    """
    ends, keys = [0], []
    with atomic_write(path) as partial, h5py.File(partial, "w") as file:
        file.attrs.update(attributes)

        def add(parts: Arrays, key: str = "") -> None:
            for name, values in parts.items():
                # An empty array may have another number of columns.
                if name in file and not len(file[name]) and len(values):
                    del file[name]
                if name not in file:
                    shape = values.shape[1:]
                    file.create_dataset(name, (0, *shape), values.dtype, maxshape=(None, *shape))
                if len(values):
                    file[name].resize(ends[-1] + len(values), axis=0)
                    file[name][ends[-1] :] = values
            ends.append(ends[-1] + len(values))
            keys.append(key.encode())

        yield add
        file["ends"] = np.array(ends[1:], np.int64)
        if any(keys):
            file["keys"] = np.array(keys)


class ArrayStore:
    """A file that ``written_store`` wrote. It stays open, so it may be removed in the meantime.

    Raises:
        InputError: the file is damaged; also when its arrays are read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._arrays: dict[str, h5py.Dataset] = {}
        try:
            require_readable(path, "file of features")
            self._file = h5py.File(path)
            self._ends = array(self._file, "ends")
        except HDF5_DAMAGE as error:
            raise self._damaged(error) from None

    def __len__(self) -> int:
        """Return the number of photographs."""
        return len(self._ends)

    def keys(self) -> list[str]:
        """Return what says of each photograph what its arrays were made of; none if unknown."""
        try:
            return [key.decode() for key in array(self._file, "keys").tolist()]
        except HDF5_DAMAGE:
            return []

    def attribute(self, name: str) -> Any:
        """Return an attribute that was written with the file."""
        try:
            return attribute(self._file, name)
        except HDF5_DAMAGE as error:
            raise self._damaged(error) from None

    def read(self, photograph: int, name: str) -> NDArray[Any]:
        """Read an array of a photograph, given by its row in ``SparseMap.names``."""
        first = int(self._ends[photograph - 1]) if photograph else 0
        try:
            # The size is compared with what is stored once, because this takes time for large
            # files.
            if name not in self._arrays:
                self._arrays[name] = dataset(self._file, name)
            return np.asarray(self._arrays[name][first : int(self._ends[photograph])])
        except HDF5_DAMAGE as error:
            raise self._damaged(error) from None

    def _damaged(self, error: Exception) -> InputError:
        return InputError(f"{self._path} is damaged ({error}): delete it")


def kept_files(cache: Path, prefix: str) -> list[Path]:
    """Return the files of a prefix in a cache, and in its folders, where processes leave parts."""
    return sorted([*cache.glob(f"{prefix}-*.h5"), *cache.glob(f"*/{prefix}-*.h5")])


class Earlier:
    """The arrays that earlier files of a cache hold of photographs, by what they were made of.

    Where photographs are added to a map, a file is written anew, as one file holds the arrays of
    all. Those that the change does not touch are copied from here.

    Args:
        paths: of files that ``written_store`` wrote; damaged and other files are passed over.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        # A cache may hold more files than a process may have open.
        self._store = lru_cache(maxsize=_OPEN)(ArrayStore)
        self._found: dict[str, tuple[Path, int]] = {}
        for path in paths:
            with suppress(InputError):
                keys = self._store(path).keys()
                self._found |= {key: (path, row) for row, key in enumerate(keys) if key}

    def read(self, key: str, names: Sequence[str]) -> dict[str, NDArray[Any]] | None:
        """Return arrays of the photograph with a key; None where no file holds them."""
        if key not in self._found:
            return None
        path, row = self._found[key]
        with suppress(InputError):
            return {name: self._store(path).read(row, name) for name in names}
        return None
