"""SHA-256 digests in hex of values and of files; digests of files are cached between runs.

The digest of a file is computed from its bytes. It is reused as long as device, inode, size and the
times of the last change (to the nanosecond) are equal. A file that changes twice within one tick of
the file system keeps its times; so a digest is not cached if the file changed just before it was
read.

The cache is the folder ``$XDG_CACHE_HOME/objconnect/digests`` or ``~/.cache/objconnect/digests``.
The variable ``OBJCONNECT_DIGESTS`` names another folder; if it is empty, the cache is off. If the
cache is absent, damaged or not writable, files are read again.
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
from objconnect.scene.storage.user_cache import user_cache

FOLDER_VARIABLE: Final = "OBJCONNECT_DIGESTS"
"""The environment variable that names the folder of the cache."""

# FAT has the coarsest time stamps, with steps of two seconds.
_TICK_NS: Final = 3 * 10**9
# A larger cache is emptied; this suffices for about 800,000 files.
_MOST_BYTES: Final = 128 << 20
_SUFFIX: Final = ".digests"
_FORMAT: Final = "objconnect digests 1"
_THREADS: Final = min(8, os.cpu_count() or 1)
# Reading more bytes than this takes long enough to show progress.
_PROGRESS_BYTES: Final = 10**9

_State = list[int]
"""Device, inode, size, and the times of the last change of content and of status (ns)."""
# Index of the size in a state.
_SIZE: Final = 2


def sha256(*pieces: str | bytes | NDArray[Any]) -> str:
    """Return the digest of concatenated bytes, texts and arrays (row by row).

    It is the digest of recorded data: maps, data sets, manifests and reports.

    Examples:
        >>> sha256("ab", "c") == sha256(b"abc")
        True
    """
    hasher = hashlib.sha256()
    for piece in pieces:
        hasher.update(_bytes(piece))
    return hasher.hexdigest()


def digest_of(*parts: object) -> str:
    """Return a digest of the inputs of a result: of the bytes of arrays, else of their text.

    It is the key of caches, and of journals that resume interrupted runs. Each part is preceded by
    its length.

    Examples:
        >>> digest_of("ab", "c") == digest_of("a", "bc")
        False
    """
    blobs = [_bytes(part) for part in parts]
    return sha256(*(each for blob in blobs for each in (f"{len(blob)} ", blob)))


def _bytes(part: object) -> bytes:
    if isinstance(part, np.ndarray):
        return part.tobytes()
    return part if isinstance(part, bytes) else str(part).encode(errors="surrogatepass")


def sha256_of(path: Path) -> str:
    """Return the digest of a file's bytes without using the cache.

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
        InputError: for the reasons of ``digests``.
    """
    return digests([path])[0]


def digests(paths: Iterable[Path], missing: str | None = None) -> list[str]:
    """Return the SHA-256 of the bytes of files, in hex, in order.

    Args:
        paths: files to read.
        missing: result for a file that does not exist; None if all files must exist.

    Raises:
        InputError: a file is missing, cannot be read, or is not a regular file.
    """
    files = list(paths)
    parts = [os.path.split(file) for file in files]
    cache = _cache_folder()
    entries = {folder: _Entries(cache, Path(folder)) for folder in {folder for folder, _ in parts}}
    known: list[str | None] = []
    size = 0
    for file, (folder, name) in zip(files, parts, strict=True):
        state = _state_of(file, missing is not None)
        known.append(missing if state is None else entries[folder].get(name, state))
        if state is not None and known[-1] is None:
            size += state[_SIZE]
    unread = [k for k, value in enumerate(known) if value is None]
    if unread:
        bar = (
            progress_bar("digests", len(unread)) if size > _PROGRESS_BYTES else nullcontext(_ignore)
        )
        with bar as advance, ThreadPoolExecutor(_THREADS) as pool:
            read = pool.map(_read, [files[k] for k in unread])
            for done, (k, (state, value)) in enumerate(zip(unread, read, strict=True), 1):
                known[k] = value
                if state is not None:
                    folder, name = parts[k]
                    entries[folder].put(name, state, value)
                advance(done)
        for folder_entries in entries.values():
            folder_entries.write()
        if cache is not None:
            _limit_size(cache)
    return [value for value in known if value is not None]


def digests_in(folder: Path, names: Iterable[str], missing: str | None = None) -> dict[str, str]:
    """Return the digests of files in a folder by name; see ``digests``."""
    keys = list(names)
    return dict(zip(keys, digests((folder / name for name in keys), missing), strict=True))


def require_unchanged(paths: Sequence[Path], old_digests: Sequence[str]) -> None:
    """Check that files still have their old digests.

    Raises:
        InputError: a file was changed, or for the reasons of ``digests``.
    """
    for path, old, new in zip(paths, old_digests, digests(paths), strict=True):
        if old != new:
            raise InputError(f"{path} was changed while it was in use: run the command again")


class _Entries:
    """The cached digests of the files directly in one folder.

    If two processes write the same entries, the later one wins.
    """

    def __init__(self, cache: Path | None, folder: Path) -> None:
        self._folder = folder
        name = sha256(os.fsencode(folder.absolute()))
        self._path = None if cache is None else cache / (name + _SUFFIX)
        self._known = self._load()
        self._new = False

    def get(self, name: str, state: _State) -> str | None:
        """Return the digest of a file whose state has not changed; else None."""
        cached_state, value = self._known.get(name, (None, None))
        return value if cached_state == state else None

    def put(self, name: str, state: _State, value: str) -> None:
        """Add a digest."""
        self._known[name] = state, value
        self._new = True

    def write(self) -> None:
        """Write all entries whose files have not changed."""
        if self._path is None or not self._new:
            return
        current = {
            name: (state, value)
            for name, (state, value) in (self._load() | self._known).items()
            if _has_state(self._folder / name, state)
        }
        text = json.dumps(current)
        try:
            with atomic_write(self._path) as partial:
                partial.write_text(f"{_header(text)}\n{text}", encoding="ascii")
        except InputError:
            return  # without a cache the program is only slower

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
        return {name: (state, value) for name, (state, value) in json.loads(text).items()}


def _ignore(done: int) -> None:
    """Replace a progress bar that is not shown."""


def _cache_folder() -> Path | None:
    """Return the folder of the cache; None if it is off."""
    chosen = os.environ.get(FOLDER_VARIABLE)
    if chosen is not None:
        return Path(chosen) if chosen else None
    base = user_cache()
    return None if base is None else base / "digests"


def _limit_size(cache: Path) -> None:
    """Empty the cache if it is too large."""
    try:
        files = [file for file in os.scandir(cache) if file.name.endswith(_SUFFIX)]
        if sum(file.stat().st_size for file in files) > _MOST_BYTES:
            for file in files:
                Path(file.path).unlink(missing_ok=True)
    except OSError:
        return


def _header(text: str) -> str:
    """Return the first line of a file of digests: a checksum of the rest."""
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
        raise _read_error(path, error) from None
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
    """Return a file's state and digest; the state is None if it may hide a later change."""
    began = time.time_ns()
    try:
        with path.open("rb") as stream:
            before = os.fstat(stream.fileno())
            value = hashlib.file_digest(stream, "sha256").hexdigest()
            after = os.fstat(stream.fileno())
    except OSError as error:
        raise _read_error(path, error) from None
    # On Windows st_ctime is the creation time.
    changed = before.st_mtime_ns if os.name == "nt" else before.st_ctime_ns
    reliable = _state(before) == _state(after) and changed + _TICK_NS < began
    return (_state(before) if reliable else None), value


def _read_error(path: Path, error: OSError) -> InputError:
    return InputError(f"cannot read {path}: {error.strerror or error}")
