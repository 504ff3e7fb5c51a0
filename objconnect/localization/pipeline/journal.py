"""A journal of the finished queries of a run, from which an interrupted run resumes."""

from __future__ import annotations

import errno
import json
import os
import re
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Generic, TypeVar

from pydantic import ValidationError

from objconnect.scene.errors import WriteError
from objconnect.scene.storage.answers import NamedRecord
from objconnect.scene.storage.atomic import TEMPORARY_PREFIX
from objconnect.scene.storage.files import parse_json
from objconnect.scene.storage.locks import hold_lock

Entry = TypeVar("Entry", bound=NamedRecord)


def journal_path(results: Path) -> Path:
    """Return the path of the journal of a results file."""
    return results.with_name(f"{TEMPORARY_PREFIX}{results.stem}.journal")


def read_parts(path: Path) -> dict[str, str] | None:
    """Return the parts of a journal's key (``Journal``); None without a readable journal."""
    try:
        with path.open(encoding="utf-8", errors="replace", newline="\n") as file:
            return _parts(_header(file.readline()))
    except OSError:
        return None


class Journal(Generic[Entry]):
    """A file with one line per finished query, which is removed when the run is complete.

    A run with another key (for example other data, another method or another version) starts over.
    The journal is a context manager; while it is open, no second run can write the same results.

    Attributes:
        done: finished queries by name.
        dropped: parts of the key of an earlier run whose queries were discarded because its key
            differs; None without such a run, or if its parts are unknown.
    """

    def __init__(
        self, path: Path, key: str, model: type[Entry], parts: Mapping[str, str] | None = None
    ) -> None:
        """Describe a journal; entering its context opens the file.

        Args:
            path: path of the file.
            key: digest of all inputs of the results.
            model: class of the entries.
            parts: parts of the key by name, such as digests of the parts of the data set, which a
                later run compares with its own to say what changed.
        """
        self.path = path
        self.done: dict[str, Entry] = {}
        self.dropped: dict[str, str] | None = None
        self._key, self._model, self._parts = key, model, dict(parts or {})

    def __enter__(self) -> Journal[Entry]:
        """Open the file and read the entries of an earlier run.

        Raises:
            InputError: another run is writing the file.
            WriteError: the file cannot be written.
        """
        parents = (self.path.parent, self.path.parent.parent)
        self._made_folders = [folder for folder in parents if not folder.exists()]
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise WriteError(f"cannot write {self.path}: {error.strerror}") from None
        with ExitStack() as opened:
            lock = self.path.with_name(f"{TEMPORARY_PREFIX}lock-{self.path.name}")
            opened.enter_context(hold_lock(lock, self.path))
            try:
                # A damaged byte must not raise here; it makes its line invalid in ``_read``.
                self._file = opened.enter_context(
                    self.path.open("a+", encoding="utf-8", errors="surrogateescape", newline="\n")
                )
            except OSError as error:
                raise WriteError(f"cannot write {self.path}: {error.strerror}") from None
            self._read()
            self._opened = opened.pop_all()
        return self

    def _read(self) -> None:
        """Read the entries of an earlier run with the same key, and discard everything else."""
        self._file.seek(0)
        # str.splitlines would also split at characters that names may contain.
        lines = re.findall("[^\n]*\n|[^\n]+$", self._file.read())
        kept_bytes = 0
        header = _header(lines[0]) if lines else {}
        if header.get("key") != self._key:
            self.dropped = _parts(header) if _parse_entries(lines[1:], self._model) else None
        else:
            entries = _parse_entries(lines[1:], self._model)
            self.done = {entry.name: entry for entry in entries}
            kept_bytes = sum(
                len(line.encode("utf-8", "surrogateescape")) for line in lines[: 1 + len(entries)]
            )
        # The rest is a line that a crash cut short, or belongs to another run.
        self._file.truncate(kept_bytes)
        if not kept_bytes:
            self._append(json.dumps({"key": self._key, "parts": self._parts}))

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file. Remove it if the run is complete or finished no query."""
        if kind is None or not self.done:
            self.path.unlink(missing_ok=True)
        self._opened.close()
        for folder in self._made_folders:
            with suppress(OSError):  # the folder is not empty
                folder.rmdir()

    def add(self, result: Entry) -> None:
        """Append a finished query.

        Raises:
            WriteError: the disk is full.
        """
        self.done[result.name] = result
        self._append(result.model_dump_json())

    def _append(self, line: str) -> None:
        data = (line + "\n").encode()
        try:
            # Unbuffered, because a buffered write that failed is tried again when the file is
            # closed.
            if os.write(self._file.fileno(), data) < len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise WriteError(f"cannot write {self.path}: {error.strerror}") from None


def _header(line: str) -> dict[str, object]:
    """Return the first line of a journal as a dictionary; empty if it is damaged."""
    try:
        header = parse_json(line)
    except ValueError:
        return {}
    return header if isinstance(header, dict) else {}


def _parts(header: Mapping[str, object]) -> dict[str, str] | None:
    """Return the parts in a header; None if they are missing or damaged."""
    parts = header.get("parts")
    if not isinstance(parts, dict) or not all(isinstance(digest, str) for digest in parts.values()):
        return None
    return parts


def _parse_entries(lines: list[str], model: type[Entry]) -> list[Entry]:
    """Return the entries up to the first line that is incomplete or invalid."""
    done: list[Entry] = []
    for line in lines:
        try:
            result = model.model_validate_json(line)
        except ValidationError:
            break
        if not line.endswith("\n"):
            break
        done.append(result)
    return done
