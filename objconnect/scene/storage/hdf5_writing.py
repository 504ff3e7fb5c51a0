"""Writing of HDF5 files that survives a full disk.

The HDF5 library crashes after a failed write. It therefore writes to a file object that never
fails: after an error of the disk, data is kept in memory, the next use of the HDF5 file raises
WriteError, and HDF5 closes normally.
"""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from objconnect.scene.errors import WriteError
from objconnect.scene.storage.atomic import atomic_write


@contextmanager
def hdf5_file(path: Path, parent: Path | None = None) -> Iterator[h5py.File]:
    """Write an HDF5 file atomically; arguments and errors are those of ``atomic_write``."""
    with atomic_write(path, parent) as partial, open_hdf5(partial, shown_path=path) as file:
        yield file


@contextmanager
def open_hdf5(path: Path, shown_path: Path | None = None) -> Iterator[h5py.File]:
    """Write an HDF5 file in place, not atomically.

    Args:
        path: file to write.
        shown_path: path in messages; None for ``path``.

    Raises:
        WriteError: the file cannot be written; it is then damaged.
    """
    shown_path = path if shown_path is None else shown_path
    try:
        raw = path.open("w+b", buffering=0)
    except OSError as error:
        raise WriteError(f"cannot write {shown_path}: {error.strerror or error}") from None
    with raw:
        safe_file = _SafeFile(raw, shown_path)
        try:
            with _CheckedFile(safe_file, "w") as file:
                yield file
        finally:
            # The error of the disk replaces errors that follow from it.
            safe_file.require_no_failure()


class _SafeFile(io.RawIOBase):
    """A file object whose writes never fail: after an error it keeps data in memory."""

    def __init__(self, raw: Any, shown_path: Path) -> None:
        super().__init__()
        self._raw = raw
        self._shown_path = shown_path
        self._position = 0
        self._error: OSError | None = None
        self._unwritten: list[tuple[int, bytes]] = []

    def require_no_failure(self) -> None:
        """Raise WriteError if a write has failed."""
        if self._error is not None:
            reason = self._error.strerror or str(self._error)
            if self._error.errno == errno.ENOSPC:
                reason = "the disk is full: free some space and run again"
            raise WriteError(f"cannot write {self._shown_path}: {reason}") from None

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._position

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        ends = [at + len(data) for at, data in self._unwritten]
        size = max([self._raw.seek(0, os.SEEK_END), *ends])
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: size}[whence]
        self._position = start + offset
        return self._position

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        done = 0
        if self._error is None:
            try:
                self._raw.seek(self._position)
                while done < len(view):
                    done += self._raw.write(view[done:])
            except OSError as error:
                self._error = error
        if done < len(view):
            self._unwritten.append((self._position + done, bytes(view[done:])))
        self._position += len(view)
        return len(view)

    def readinto(self, buffer: Any) -> int:
        view = memoryview(buffer).cast("B")
        view[:] = bytes(len(view))
        self._raw.seek(self._position)
        done = 0
        while done < len(view) and (count := self._raw.readinto(view[done:])):
            done += count
        for start, data in self._unwritten:
            first, last = (
                max(start, self._position),
                min(start + len(data), self._position + len(view)),
            )
            if first < last:
                view[first - self._position : last - self._position] = data[
                    first - start : last - start
                ]
                done = max(done, last - self._position)
        self._position += done
        return done

    def truncate(self, size: int | None = None) -> int:
        size = self._position if size is None else size
        if self._error is None:
            try:
                self._raw.truncate(size)
            except OSError as error:
                self._error = error
        return size

    def flush(self) -> None:
        """Do nothing: the file has no buffer."""


class _CheckedFile(h5py.File):  # type: ignore[misc]
    """An HDF5 file that raises the disk's error on each access."""

    def __init__(self, safe_file: _SafeFile, mode: str) -> None:
        self._safe_file = safe_file
        super().__init__(safe_file, mode)

    def __getitem__(self, name: Any) -> Any:
        self._safe_file.require_no_failure()
        return super().__getitem__(name)

    def __setitem__(self, name: str, value: Any) -> None:
        self._safe_file.require_no_failure()
        super().__setitem__(name, value)
        self._safe_file.require_no_failure()

    def create_group(self, *words: Any, **options: Any) -> Any:
        self._safe_file.require_no_failure()
        return super().create_group(*words, **options)

    def create_dataset(self, *words: Any, **options: Any) -> Any:
        self._safe_file.require_no_failure()
        dataset = super().create_dataset(*words, **options)
        self._safe_file.require_no_failure()
        return dataset
