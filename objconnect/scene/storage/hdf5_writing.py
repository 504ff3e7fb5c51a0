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
def hdf5_file(path: Path, beside: Path | None = None) -> Iterator[h5py.File]:
    """Write an HDF5 file atomically; arguments and errors are those of ``atomic_write``."""
    with atomic_write(path, beside) as partial, open_hdf5(partial, called=path) as file:
        yield file


@contextmanager
def open_hdf5(path: Path, called: Path | None = None) -> Iterator[h5py.File]:
    """Write an HDF5 file in place, not atomically.

    Args:
        path: file to write.
        called: path in messages; None for ``path``.

    Raises:
        WriteError: the file cannot be written; it is then damaged.
    """
    called = path if called is None else called
    try:
        disk = path.open("w+b", buffering=0)
    except OSError as error:
        raise WriteError(f"cannot write {called}: {error.strerror or error}") from None
    with disk:
        safe_file = _Disk(disk, called)
        try:
            with _File(safe_file, "w") as file:
                yield file
        finally:
            # The error of the disk replaces errors that follow from it.
            safe_file.require_room()


class _Disk(io.RawIOBase):
    """A file object whose writes never fail: after an error it keeps data in memory."""

    def __init__(self, disk: Any, called: Path) -> None:
        super().__init__()
        self._disk = disk
        self._called = called
        self._at = 0
        self._error: OSError | None = None
        self._left: list[tuple[int, bytes]] = []

    def require_room(self) -> None:
        """Raise WriteError if a write has failed."""
        if self._error is not None:
            reason = self._error.strerror or str(self._error)
            if self._error.errno == errno.ENOSPC:
                reason = "the disk is full: free some and run again"
            raise WriteError(f"cannot write {self._called}: {reason}") from None

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        ends = [at + len(data) for at, data in self._left]
        size = max([self._disk.seek(0, os.SEEK_END), *ends])
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: size}[whence]
        self._at = start + offset
        return self._at

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        done = 0
        if self._error is None:
            try:
                self._disk.seek(self._at)
                while done < len(view):
                    done += self._disk.write(view[done:])
            except OSError as error:
                self._error = error
        if done < len(view):
            self._left.append((self._at + done, bytes(view[done:])))
        self._at += len(view)
        return len(view)

    def readinto(self, buffer: Any) -> int:
        view = memoryview(buffer).cast("B")
        view[:] = bytes(len(view))
        self._disk.seek(self._at)
        done = 0
        while done < len(view) and (count := self._disk.readinto(view[done:])):
            done += count
        for start, data in self._left:
            first, last = max(start, self._at), min(start + len(data), self._at + len(view))
            if first < last:
                view[first - self._at : last - self._at] = data[first - start : last - start]
                done = max(done, last - self._at)
        self._at += done
        return done

    def truncate(self, size: int | None = None) -> int:
        size = self._at if size is None else size
        if self._error is None:
            try:
                self._disk.truncate(size)
            except OSError as error:
                self._error = error
        return size

    def flush(self) -> None:
        """Do nothing: the file has no buffer."""


class _File(h5py.File):  # type: ignore[misc]
    """An HDF5 file that raises the disk's error on each access."""

    def __init__(self, disk: _Disk, mode: str) -> None:
        self._disk = disk
        super().__init__(disk, mode)

    def __getitem__(self, name: Any) -> Any:
        self._disk.require_room()
        return super().__getitem__(name)

    def __setitem__(self, name: str, value: Any) -> None:
        self._disk.require_room()
        super().__setitem__(name, value)
        self._disk.require_room()

    def create_group(self, *words: Any, **options: Any) -> Any:
        self._disk.require_room()
        return super().create_group(*words, **options)

    def create_dataset(self, *words: Any, **options: Any) -> Any:
        self._disk.require_room()
        made = super().create_dataset(*words, **options)
        self._disk.require_room()
        return made
