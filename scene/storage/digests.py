"""Digests of files, remembered from one run to the next.

A digest is of the bytes on disk, never of what a list claims. A file is not read again while it is
the file that was read: same device, inode and size, same times of its last change, to the
nanosecond. Those times are compared for equality alone, with one exception. A file system counts
time in ticks: a file that changes twice within one keeps its times. So nothing is remembered of a
file that had changed just before it was read.

What is remembered lies in a folder of the user's, ``$XDG_CACHE_HOME/objconnect/digests`` or
``~/.cache/objconnect/digests``; ``OBJCONNECT_DIGESTS`` names another, and an empty value none. It
only saves time: where it is absent, damaged, or cannot be written, files are read again.
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
from typing import Final

from scene.errors import InputError
from scene.runtime.progress import progress_bar
from scene.storage.files import written_whole

FOLDER_VARIABLE: Final = "OBJCONNECT_DIGESTS"

# The longest tick of a file system in use is FAT's, of two seconds.
_TICK_NS: Final = 3 * 10**9
# When the files of the folder are larger together they are removed, and it begins anew. That is
# room for about 800,000 files.
_MOST_BYTES: Final = 128 << 20
_ENDING: Final = ".digests"
_FORMAT: Final = "objconnect digests 1"
_THREADS: Final = min(8, os.cpu_count() or 1)
# Bytes that take long enough to read for a person to be shown how far it is.
_LONG: Final = 10**9

_State = list[int]
"""Device, inode, size, and the times of the last change of content and of status in ns."""
_SIZE: Final = 2


def digest(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex.

    Raises:
        InputError: as ``digests``.
    """
    return digests([path])[0]


def digests(paths: Iterable[Path], missing: str | None = None) -> list[str]:
    """SHA-256 of the bytes of files, in hex, in the order given.

    Args:
        paths: of the files.
        missing: what stands for a file that does not exist; None where all have to.

    Raises:
        InputError: one is missing, cannot be read, or is not a regular file.
    """
    files = list(paths)
    places = [os.path.split(file) for file in files]
    kept = _folder()
    shelves = {folder: _Shelf(kept, Path(folder)) for folder in {folder for folder, _ in places}}
    found: list[str | None] = []
    size = 0
    for file, (folder, name) in zip(files, places, strict=True):
        state = _state_of(file, missing is not None)
        found.append(missing if state is None else shelves[folder].get(name, state))
        if state is not None and found[-1] is None:
            size += state[_SIZE]
    unread = [k for k, known in enumerate(found) if known is None]
    if unread:
        bar = progress_bar("digests", len(unread)) if size > _LONG else nullcontext(_say_nothing)
        with bar as advance, ThreadPoolExecutor(_THREADS) as pool:
            read = pool.map(_read, [files[k] for k in unread])
            for done, (k, (state, sha256)) in enumerate(zip(unread, read, strict=True), 1):
                found[k] = sha256
                if state is not None:
                    folder, name = places[k]
                    shelves[folder].put(name, state, sha256)
                advance(done)
        for shelf in shelves.values():
            shelf.write()
        if kept is not None:
            _bound(kept)
    return [known for known in found if known is not None]


def require_unchanged(paths: Sequence[Path], before: Sequence[str]) -> None:
    """Make sure that files are still those whose digests were taken.

    Raises:
        InputError: one is not, or as ``digests``.
    """
    for path, was, now in zip(paths, before, digests(paths), strict=True):
        if was != now:
            raise InputError(f"{path} was changed while it was in use: run the command again")


class _Shelf:
    """What is remembered of the files directly in one folder.

    Two processes may write it at once: the later one wins, and what the other found out is read
    again some day.
    """

    def __init__(self, kept: Path | None, folder: Path) -> None:
        self._folder = folder
        name = hashlib.sha256(os.fsencode(folder.absolute())).hexdigest()
        self._path = None if kept is None else kept / (name + _ENDING)
        self._known = self._load()
        self._new = False

    def get(self, name: str, state: _State) -> str | None:
        """The digest of a file that is still in the state it was read in."""
        was, sha256 = self._known.get(name, (None, None))
        return sha256 if was == state else None

    def put(self, name: str, state: _State, sha256: str) -> None:
        """Remember a digest."""
        self._known[name] = state, sha256
        self._new = True

    def write(self) -> None:
        """Keep what is new, and what is still true of the rest."""
        if self._path is None or not self._new:
            return
        true = {
            name: (state, sha256)
            for name, (state, sha256) in (self._load() | self._known).items()
            if _is(self._folder / name, state)
        }
        text = json.dumps(true)
        try:
            with written_whole(self._path) as partial:
                partial.write_text(f"{_header(text)}\n{text}", encoding="ascii")
        except InputError:
            return  # it cannot be kept

    def _load(self) -> dict[str, tuple[_State, str]]:
        """What the file says; nothing when it is not whole."""
        if self._path is None:
            return {}
        try:
            header, _, text = self._path.read_text(encoding="ascii").partition("\n")
        except (OSError, ValueError):
            return {}
        if header != _header(text):
            return {}
        return {name: (state, sha256) for name, (state, sha256) in json.loads(text).items()}


def _say_nothing(done: int) -> None:
    """Progress that nobody has to be shown."""


def _folder() -> Path | None:
    """Where digests are remembered; None for nowhere."""
    given = os.environ.get(FOLDER_VARIABLE)
    if given is not None:
        return Path(given) if given else None
    try:
        base = Path(os.environ.get("XDG_CACHE_HOME", ""))
        base = base if base.is_absolute() else Path.home() / ".cache"
    except RuntimeError:  # nobody knows where home is
        return None
    return base / "objconnect" / "digests"


def _bound(kept: Path) -> None:
    """Empty the folder of what is ours when there is too much of it."""
    try:
        ours = [file for file in os.scandir(kept) if file.name.endswith(_ENDING)]
        if sum(file.stat().st_size for file in ours) > _MOST_BYTES:
            for file in ours:
                Path(file.path).unlink(missing_ok=True)
    except OSError:
        return


def _header(text: str) -> str:
    """The first line of a file of digests, which shows whether the rest is whole."""
    return f"{_FORMAT} {hashlib.sha256(text.encode('ascii')).hexdigest()}"


def _state(status: os.stat_result) -> _State:
    return [
        status.st_dev,
        status.st_ino,
        status.st_size,
        status.st_mtime_ns,
        status.st_ctime_ns,
    ]


def _state_of(path: Path, optional: bool) -> _State | None:
    """The state of a file that is to be read; None for an optional one that does not exist."""
    try:
        status = path.stat()
    except OSError as error:
        if optional and isinstance(error, FileNotFoundError):
            return None
        raise _unreadable(path, error) from None
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{path} is not a regular file")
    return _state(status)


def _is(path: Path, state: _State) -> bool:
    """Whether a file is still in a state."""
    try:
        return _state(path.stat()) == state
    except OSError:
        return False


def _read(path: Path) -> tuple[_State | None, str]:
    """The digest of a file, and its state where a later change would show in that."""
    began = time.time_ns()
    try:
        with path.open("rb") as stream:
            before = os.fstat(stream.fileno())
            sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
            after = os.fstat(stream.fileno())
    except OSError as error:
        raise _unreadable(path, error) from None
    # On Windows the time of status is that of the file's making.
    changed = before.st_mtime_ns if os.name == "nt" else before.st_ctime_ns
    tells = _state(before) == _state(after) and changed + _TICK_NS < began
    return (_state(before) if tells else None), sha256


def _unreadable(path: Path, error: OSError) -> InputError:
    return InputError(f"cannot read {path}: {error.strerror or error}")
