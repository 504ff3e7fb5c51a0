"""HDF5 files of rows of arrays, usually one row per photograph of a map."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, Final, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import HDF5_DAMAGE, InputError
from objconnect.scene.storage.files import require_readable
from objconnect.scene.storage.hdf5 import array, dataset, group
from objconnect.scene.storage.hdf5_writing import hdf5_file
from objconnect.scene.storage.scratch import scratch

# Maximum number of lines and of bytes of a chunk of an HDF5 data set. h5py's own choice divides
# columns too and takes eight times as long to read.
_CHUNK_LINES: Final = 512
_CHUNK_BYTES: Final = 1 << 18

T = TypeVar("T")
Arrays = Mapping[str, NDArray[Any]]
"""Arrays of a row by name. Each row of a file has the same names; lengths may differ."""
Row = tuple[str, Arrays]
"""A digest of a row's inputs, empty if unknown, and its arrays."""
Rows = Generator[Row, None, None]


def write_store(path: Path, rows: Rows) -> None:
    """Write a file of rows, which appears when it is complete.

    Until then it lies in a scratch folder. If this process is killed, the next writer removes the
    folder.

    Raises:
        WriteError: the folder cannot be written, or the disk is full.
    """
    keys: list[bytes] = []
    ends: dict[str, list[int]] = {}
    with closing(rows), scratch(path.parent) as folder, hdf5_file(path, folder) as file:
        for key, arrays in rows:
            keys.append(key.encode())
            for name, values in arrays.items():
                ends.setdefault(name, []).append(_append(file, f"arrays/{name}", values))
        file["made_of"] = np.array(keys, "S64")
        for name, end_lines in ends.items():
            file[f"ends/{name}"] = np.array(end_lines, np.int64)


def _append(file: h5py.File, name: str, values: NDArray[Any]) -> int:
    """Append the lines of an array to a data set and return its new length."""
    # An empty data set may have another number of columns than the array.
    if name in file and not len(file[name]) and len(values):
        del file[name]
    if name not in file:
        shape = values.shape[1:]
        line_bytes = values.dtype.itemsize * int(np.prod(shape))
        lines = min(_CHUNK_LINES, max(1, _CHUNK_BYTES // max(line_bytes, 1)))
        file.create_dataset(
            name,
            (0, *shape),
            values.dtype,
            maxshape=(None, *shape),
            chunks=(lines, *shape) if all(shape) else True,
        )
    begin = len(file[name])
    if len(values):
        file[name].resize(begin + len(values), axis=0)
        file[name][begin:] = values
    return begin + len(values)


class Store:
    """A file of ``write_store``. It stays open, so that it can be read after its removal.

    Threads may share it.

    Attributes:
        rows: indices of rows by their keys, the digests of their inputs; rows of an empty key are
            left out.

    Raises:
        InputError: the file is damaged. The methods that read it raise this error too.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._arrays: dict[str, tuple[h5py.Dataset, list[int]]] = {}
        try:
            require_readable(path, "file of the cache")
            self._file = h5py.File(path)
            keys = array(self._file, "made_of").tolist()
            self._count = len(keys)
            self.rows = {key.decode(): row for row, key in enumerate(keys) if key}
        except HDF5_DAMAGE as error:
            raise self._damage_error(error) from None

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._count

    def row(self, key: str) -> int:
        """Return the index of the row with a key."""
        if key not in self.rows:
            raise self._damage_error(KeyError("the row of a photograph is missing"))
        return self.rows[key]

    def read(self, row: int, name: str) -> NDArray[Any]:
        """Read an array of a row."""
        try:
            # ``dataset`` checks the size of the file. That takes time, so it runs once per name.
            if name not in self._arrays:
                ends = [0, *array(group(self._file, "ends"), name).tolist()]
                self._arrays[name] = dataset(group(self._file, "arrays"), name), ends
            values, ends = self._arrays[name]
            return np.asarray(values[ends[row] : ends[row + 1]])
        except HDF5_DAMAGE as error:
            raise self._damage_error(error) from None

    def arrays(self, row: int, names: Iterable[str]) -> dict[str, NDArray[Any]]:
        """Read arrays of a row by their names."""
        return {name: self.read(row, name) for name in names}

    def make(self, row: int, names: Iterable[str], build: Callable[[Arrays], T]) -> T:
        """Return an object that ``build`` makes from arrays of a row.

        If ``build`` fails, the file is reported as damaged.
        """
        try:
            return build(self.arrays(row, names))
        except HDF5_DAMAGE as error:
            raise self._damage_error(error) from None

    def _damage_error(self, error: Exception) -> InputError:
        return InputError(f"{self._path} is damaged ({error}): delete it")
