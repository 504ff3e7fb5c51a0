"""Folders that are written step by step, which the same command continues after an interruption.

A record in such a folder contains the request. It is written before the first step. A later command
with the same request continues, and a command with another request refuses the folder or starts
again.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.storage.atomic import is_temporary, write_text
from objconnect.scene.storage.leftovers import remove_partial


@dataclass(frozen=True)
class ResumableFolder:
    """A folder, and what is asked for in it.

    Attributes:
        path: The folder that is written step by step.
        record: The file in it that says what was asked for.
        request: The text of the record: what is asked for now.
        difference: Compares what was recorded, at the path it is given, with what is asked for
            now. It returns None where they are the same and otherwise says in what they differ; it
            raises ``InputError`` where the record is damaged.
    """

    path: Path
    record: Path
    request: str
    difference: Callable[[Path], str | None]

    def is_begun(self) -> bool:
        """Return whether the folder holds a record, of this request or of another one."""
        return self.record.is_file()

    def is_same(self) -> bool:
        """Return whether the folder holds the record of this very request.

        Raises:
            InputError: The record is damaged.
        """
        return self.is_begun() and self.difference(self.record) is None

    def resume(self, refusal: Callable[[str], str]) -> bool:
        """Return whether there is work of this request to go on with.

        Args:
            refusal: Makes the message for a folder of another request out of what differs.

        Raises:
            InputError: The record is damaged, or is that of another request.
        """
        if not self.is_begun():
            return False
        difference = self.difference(self.record)
        if difference is not None:
            raise InputError(refusal(difference))
        return True

    def require_empty(self, what: str) -> None:
        """Check that a folder holds no files of other programs.

        A command that was killed before it wrote its record leaves only temporary files of ours;
        these do not count.

        Args:
            what: What the folder is to become, for the message, as "scene".

        Raises:
            InputError: The folder is not empty, or cannot be read.
        """
        try:
            occupied = self.path.exists() and any(
                not is_temporary(item.name) for item in self.path.iterdir()
            )
        except OSError as error:
            raise InputError(f"cannot use {self.path} for a {what}: {error.strerror}") from None
        if occupied:
            raise InputError(f"{self.path} is not empty and not a {what}: choose another folder")

    def begin(self) -> None:
        """Write the record and remove the half-written files of a process that was killed.

        Raises:
            WriteError: The folder cannot be written.
        """
        write_text(self.record, self.request)
        try:
            remove_partial(self.path)
        except OSError as error:
            raise WriteError(f"cannot write {self.path}: {error.strerror or error}") from None

    def end(self) -> None:
        """Remove the record of finished work.

        The record may lie in the folder itself, or in a hidden folder of intermediate results,
        which goes with it. Ending twice does no harm: a process may be killed at its very end.
        """
        if self.record.parent == self.path:
            self.record.unlink(missing_ok=True)
        else:
            shutil.rmtree(self.record.parent, ignore_errors=True)
