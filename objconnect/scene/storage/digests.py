"""Digests, all of them SHA-256 in hex: of values, and of files, cached from one run to the next.

That of a file is computed from the bytes on disk, never taken from a list. A file is not read
again as long as it is the file that was read: same device, inode and size, and same times of its
last change, to the nanosecond. The times are only compared for equality, with one exception: a file
system counts time in ticks, and a file that changes twice within one keeps its times. Therefore no
digest is cached of a file that had changed just before it was read.

The cache is the folder ``$XDG_CACHE_HOME/objconnect/digests`` or ``~/.cache/objconnect/digests``;
the variable ``OBJCONNECT_DIGESTS`` names another one, and its empty value switches the cache off.
The cache only saves time: where it is absent, damaged, or cannot be written, files are read again.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.files import require_readable

FOLDER_VARIABLE: Final = "OBJCONNECT_DIGESTS"
"""The environment variable that names the folder of the cache."""

# The coarsest time stamps of file systems in use are FAT's, with steps of two seconds.
_TICK_NS: Final = 3 * 10**9
# When the cache is larger than this it is emptied. That is enough for about 800,000 files.
_MOST_BYTES: Final = 128 << 20
_ENDING: Final = ".digests"
_FORMAT: Final = "objconnect digests 1"
_THREADS: Final = min(8, os.cpu_count() or 1)
# Reading more bytes than this takes long enough to show progress.
_LONG: Final = 10**9

_State = list[int]
"""Device, inode, size, and the times of the last change of content and of status (ns)."""
# The place of the size in a state.
_SIZE: Final = 2


def sha256(*pieces: str | bytes | NDArray[Any]) -> str:
    """Return the digest of pieces that follow one another: bytes, text, arrays row by row.

    It is that of records: of maps, data sets, manifests and reports.

    Example:
        >>> sha256("ab", "c") == sha256(b"abc")
        True
    """
    found = hashlib.sha256()
    for piece in pieces:
        found.update(_bytes(piece))
    return found.hexdigest()


def digest_of(*parts: object) -> str:
    """Return a digest of all that something was made of: of the bytes of arrays, else of text.

    It is that of caches and journals. Each part begins with its length.

    Example:
        >>> digest_of("ab", "c") == digest_of("a", "bc")
        False
    """
    found = [_bytes(part) for part in parts]
    return sha256(*(each for data in found for each in (f"{len(data)} ", data)))


def _bytes(part: object) -> bytes:
    if isinstance(part, np.ndarray):
        return part.tobytes()
    return part if isinstance(part, bytes) else str(part).encode(errors="surrogatepass")


def sha256_of(path: Path) -> str:
    """Return the digest of a file's bytes, which are read whatever is known of the file.

    Raises:
        InputError: the path is not a regular file, see ``require_readable``.
        OSError: the file cannot be read.
    """
    require_readable(path, "file")
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def digest(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hex.

    Raises:
        InputError: as for ``digests``.
    """
    return digests([path])[0]


def digests(paths: Iterable[Path], missing: str | None = None) -> list[str]:
    """Return the SHA-256 of the bytes of files, in hex, in the order given.

    Args:
        paths: files to read.
        missing: value returned for a file that does not exist; None if all files must exist.

    Raises:
        InputError: a file is missing, cannot be read, or is not a regular file.
    """
    files = list(paths)
    places = [os.path.split(file) for file in files]
    cache = _folder()
    entries = {folder: _Entries(cache, Path(folder)) for folder in {folder for folder, _ in places}}
    known: list[str | None] = []
    size = 0
    for file, (folder, name) in zip(files, places, strict=True):
        state = _state_of(file, missing is not None)
        known.append(missing if state is None else entries[folder].get(name, state))
        if state is not None and known[-1] is None:
            size += state[_SIZE]
    unread = [k for k, found in enumerate(known) if found is None]
    if unread:
        bar = progress_bar("digests", len(unread)) if size > _LONG else nullcontext(_say_nothing)
        with bar as advance, ThreadPoolExecutor(_THREADS) as pool:
            read = pool.map(_read, [files[k] for k in unread])
            for done, (k, (state, found)) in enumerate(zip(unread, read, strict=True), 1):
                known[k] = found
                if state is not None:
                    folder, name = places[k]
                    entries[folder].put(name, state, found)
                advance(done)
        for entry in entries.values():
            entry.write()
        if cache is not None:
            _limit_size(cache)
    return [found for found in known if found is not None]


def digests_in(folder: Path, names: Iterable[str], missing: str | None = None) -> dict[str, str]:
    """Return the digests of files in a folder by name; see ``digests``."""
    named = list(names)
    return dict(zip(named, digests((folder / name for name in named), missing), strict=True))


def require_unchanged(paths: Sequence[Path], before: Sequence[str]) -> None:
    """Make sure that files still have the digests that were computed before.

    Raises:
        InputError: a file was changed, or as for ``digests``.
    """
    for path, was, now in zip(paths, before, digests(paths), strict=True):
        if was != now:
            raise InputError(f"{path} was changed while it was in use: run the command again")


class _Entries:
    """The cached digests of the files directly in one folder.

    Two processes may write the same entries: the later one wins, and the digests of the other are
    computed again in a later run.
    """

    def __init__(self, cache: Path | None, folder: Path) -> None:
        self._folder = folder
        name = sha256(os.fsencode(folder.absolute()))
        self._path = None if cache is None else cache / (name + _ENDING)
        self._known = self._load()
        self._new = False

    def get(self, name: str, state: _State) -> str | None:
        """Return the digest of a file that is still in the state it was read in, else None."""
        was, found = self._known.get(name, (None, None))
        return found if was == state else None

    def put(self, name: str, state: _State, found: str) -> None:
        """Add a digest."""
        self._known[name] = state, found
        self._new = True

    def write(self) -> None:
        """Write the entries, new and old, that still hold."""
        if self._path is None or not self._new:
            return
        current = {
            name: (state, found)
            for name, (state, found) in (self._load() | self._known).items()
            if _has_state(self._folder / name, state)
        }
        text = json.dumps(current)
        try:
            with atomic_write(self._path) as partial:
                partial.write_text(f"{_header(text)}\n{text}", encoding="ascii")
        except InputError:
            return  # the cache cannot be written, which only costs time

    def _load(self) -> dict[str, tuple[_State, str]]:
        """Return the entries of the file; none if it is damaged."""
        if self._path is None:
            return {}
        try:
            header, _, text = self._path.read_text(encoding="ascii").partition("\n")
        except (OSError, ValueError):
            return {}
        if header != _header(text):
            return {}
        return {name: (state, found) for name, (state, found) in json.loads(text).items()}


def _say_nothing(done: int) -> None:
    """Take the place of a progress bar that is not shown."""


def _folder() -> Path | None:
    """Return the folder of the cache, or None if it is switched off."""
    given = os.environ.get(FOLDER_VARIABLE)
    if given is not None:
        return Path(given) if given else None
    try:
        base = Path(os.environ.get("XDG_CACHE_HOME", ""))
        base = base if base.is_absolute() else Path.home() / ".cache"
    except RuntimeError:  # the home folder is unknown
        return None
    return base / "objconnect" / "digests"


def _limit_size(cache: Path) -> None:
    """Empty the cache when it is too large."""
    try:
        files = [file for file in os.scandir(cache) if file.name.endswith(_ENDING)]
        if sum(file.stat().st_size for file in files) > _MOST_BYTES:
            for file in files:
                Path(file.path).unlink(missing_ok=True)
    except OSError:
        return


def _header(text: str) -> str:
    """Return the first line of a file of digests: a check sum of the rest."""
    return f"{_FORMAT} {sha256(text)}"


def _state(status: os.stat_result) -> _State:
    return [
        status.st_dev,
        status.st_ino,
        status.st_size,
        status.st_mtime_ns,
        status.st_ctime_ns,
    ]


def _state_of(path: Path, optional: bool) -> _State | None:
    """Return the state of a file to be read; None for an optional file that does not exist."""
    try:
        status = path.stat()
    except OSError as error:
        if optional and isinstance(error, FileNotFoundError):
            return None
        raise _unreadable(path, error) from None
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{path} is not a regular file")
    return _state(status)


def _has_state(path: Path, state: _State) -> bool:
    """Return whether a file still has a recorded state."""
    try:
        return _state(path.stat()) == state
    except OSError:
        return False


def _read(path: Path) -> tuple[_State | None, str]:
    """Return the digest of a file, and its state, which is None if it may hide a later change."""
    began = time.time_ns()
    try:
        with path.open("rb") as stream:
            before = os.fstat(stream.fileno())
            found = hashlib.file_digest(stream, "sha256").hexdigest()
            after = os.fstat(stream.fileno())
    except OSError as error:
        raise _unreadable(path, error) from None
    # On Windows st_ctime is the time at which the file was made.
    changed = before.st_mtime_ns if os.name == "nt" else before.st_ctime_ns
    reliable = _state(before) == _state(after) and changed + _TICK_NS < began
    return (_state(before) if reliable else None), found


def _unreadable(path: Path, error: OSError) -> InputError:
    return InputError(f"cannot read {path}: {error.strerror or error}")
