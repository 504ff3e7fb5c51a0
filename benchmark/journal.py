"""Finished queries of an unfinished run, so that a crash loses none."""

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

from benchmark.results import Named
from scene.errors import WriteError
from scene.storage.files import MARK, locked, parse_json

Entry = TypeVar("Entry", bound=Named)


def journal_path(results: Path) -> Path:
    """Where the journal of a results file lies."""
    return results.with_name(f"{MARK}{results.stem}.journal")


class Journal(Generic[Entry]):
    """A file of one line per finished query; it goes when the run is complete.

    A run of another key (other data, method, configuration, start or version) starts over. Used as
    a context manager; while it is open no second run writes the same results.
    """

    def __init__(
        self, path: Path, key: str, model: type[Entry], parts: Mapping[str, str] | None = None
    ) -> None:
        """
        Args:
            path: of the file.
            key: digest of everything that decides the results.
            model: of what is kept of a query.
            parts: digests of what the data set is made of, to tell a later run what changed.

        Attributes:
            done: finished queries by name.
            dropped: the parts of the data set whose finished queries were not taken; None where
                there were none, or nobody knows.
        """
        self.path = path
        self.done: dict[str, Entry] = {}
        self.dropped: dict[str, str] | None = None
        self._key, self._model, self._parts = key, model, dict(parts or {})

    def __enter__(self) -> Journal[Entry]:
        """Read what is there.

        Raises:
            InputError: it cannot be written, or another run is writing it.
        """
        above = (self.path.parent, self.path.parent.parent)
        self._made = [folder for folder in above if not folder.exists()]
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise WriteError(f"cannot write {self.path}: {error.strerror}") from None
        with ExitStack() as opened:
            lock = self.path.with_name(f"{MARK}lock-{self.path.name}")
            opened.enter_context(locked(lock, self.path))
            try:
                # A damaged byte ends what is good, as any damage does.
                self._file = opened.enter_context(
                    self.path.open("a+", encoding="utf-8", errors="surrogateescape", newline="\n")
                )
            except OSError as error:
                raise WriteError(f"cannot write {self.path}: {error.strerror}") from None
            self._begin()
            self._opened = opened.pop_all()
        return self

    def _begin(self) -> None:
        self._file.seek(0)
        # Names may hold what Python takes for ends of lines, too.
        lines = re.findall("[^\n]*\n|[^\n]+$", self._file.read())
        good = 0
        header = _header(lines[0]) if lines else {}
        if header.get("key") != self._key:
            self.dropped = _parts(header) if _finished(lines[1:], self._model) else None
        else:
            self.done = _finished(lines[1:], self._model)
            good = sum(
                len(line.encode("utf-8", "surrogateescape")) for line in lines[: 1 + len(self.done)]
            )
        # What follows was cut short, or belongs to another run.
        self._file.truncate(good)
        if not good:
            self._put(json.dumps({"key": self._key, "parts": self._parts}))

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close; the file stays when a run ends badly after its first query."""
        if kind is None or not self.done:
            self.path.unlink(missing_ok=True)
        self._opened.close()
        for folder in self._made:
            with suppress(OSError):  # it holds something
                folder.rmdir()

    def add(self, result: Entry) -> None:
        """Note a finished query.

        Raises:
            WriteError: the disk is full.
        """
        self.done[result.name] = result
        self._put(result.model_dump_json())

    def _put(self, line: str) -> None:
        data = (line + "\n").encode()
        try:
            # Past the buffer, which would try again when the file is closed.
            if os.write(self._file.fileno(), data) < len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise WriteError(f"cannot write {self.path}: {error.strerror}") from None


def _header(line: str) -> dict[str, object]:
    try:
        header = parse_json(line)
    except ValueError:
        return {}
    return header if isinstance(header, dict) else {}


def _parts(header: Mapping[str, object]) -> dict[str, str] | None:
    parts = header.get("parts")
    if not isinstance(parts, dict) or not all(isinstance(of, str) for of in parts.values()):
        return None
    return parts


def _finished(lines: list[str], model: type[Entry]) -> dict[str, Entry]:
    """Queries up to the first line that is none: the process died while writing it."""
    done: dict[str, Entry] = {}
    for line in lines:
        try:
            result = model.model_validate_json(line)
        except ValidationError:
            break
        if result.name in done or not line.endswith("\n"):
            break
        done[result.name] = result
    return done
