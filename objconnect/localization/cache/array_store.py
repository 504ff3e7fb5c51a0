"""A file of arrays of all photographs of a map, from which those of a photograph can be read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Protocol

import h5py
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import HDF5_DAMAGE, InputError
from objconnect.scene.storage.files import require_readable
from objconnect.scene.storage.hdf5 import array, attribute, dataset
from objconnect.scene.storage.hdf5_writing import hdf5_file

# A photograph has hundreds of rows. Chunks that HDF5 chooses by itself divide the columns, too, and
# take eight times as long to read.
_CHUNK_ROWS: Final = 512

Arrays = Mapping[str, NDArray[Any]]
"""Arrays of one photograph, by name; all have the same number of rows."""


class Add(Protocol):
    """Adds the arrays of the next photograph to a file."""

    def __call__(self, parts: Arrays, key: str = "") -> None:
        """Add arrays; ``key`` says what they were made of: see ``earlier.key_of``."""
        ...


@contextmanager
def written_store(path: Path, **attributes: float) -> Iterator[Add]:
    """Write a file of arrays; yield a function that adds the arrays of the next photograph.

    The file appears only when it is complete.

    Raises:
        InputError: the folder cannot be written.
    """
    ends, keys = [0], []
    with hdf5_file(path) as file:
        file.attrs.update(attributes)

        def add(parts: Arrays, key: str = "") -> None:
            for name, values in parts.items():
                # An empty array may have another number of columns.
                if name in file and not len(file[name]) and len(values):
                    del file[name]
                if name not in file:
                    shape = values.shape[1:]
                    file.create_dataset(
                        name,
                        (0, *shape),
                        values.dtype,
                        maxshape=(None, *shape),
                        chunks=(_CHUNK_ROWS, *shape) if all(shape) else True,
                    )
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

    def by_key(self) -> dict[str, int]:
        """Return the photographs of which is known what their arrays were made of, by that."""
        try:
            keys = array(self._file, "keys").tolist()
        except HDF5_DAMAGE:
            return {}
        return {key.decode(): photograph for photograph, key in enumerate(keys) if key}

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

    def arrays(self, photograph: int, names: Sequence[str]) -> dict[str, NDArray[Any]]:
        """Read arrays of a photograph by their names."""
        return {name: self.read(photograph, name) for name in names}

    def _damaged(self, error: Exception) -> InputError:
        return InputError(f"{self._path} is damaged ({error}): delete it")
