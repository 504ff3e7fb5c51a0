"""Folders that are written step by step and resumed after an interruption.

A record with the request is written to the folder before the first step. A later command with the
same request resumes; one with another request refuses the folder or starts again.
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
    """A folder that is written step by step, with the request of the present command.

    Attributes:
        path: the folder.
        record: the file in it that records the request.
        request: text of the record for the present command.
        find_difference: compares the record at a path with the present request. It returns None if
            they are equal, else a phrase with the difference, and raises ``InputError`` if the
            record is damaged.
    """

    path: Path
    record: Path
    request: str
    find_difference: Callable[[Path], str | None]

    def is_begun(self) -> bool:
        """Return whether the folder holds a record of any request."""
        return self.record.is_file()

    def has_same_request(self) -> bool:
        """Return whether the folder holds a record of the same request.

        Raises:
            InputError: the record is damaged.
        """
        return self.is_begun() and self.find_difference(self.record) is None

    def can_resume(self, describe_refusal: Callable[[str], str]) -> bool:
        """Return whether there is work of the same request to resume.

        Args:
            describe_refusal: returns the error message for a difference between the requests.

        Raises:
            InputError: the record is damaged, or is of another request.
        """
        if not self.is_begun():
            return False
        difference = self.find_difference(self.record)
        if difference is not None:
            raise InputError(describe_refusal(difference))
        return True

    def require_empty(self, what: str) -> None:
        """Refuse a folder that holds files other than our temporary ones.

        Args:
            what: noun for the result in the message, such as "scene".

        Raises:
            InputError: the folder is not empty, or cannot be read.
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
        """Write the record, and remove temporary files of killed processes.

        Raises:
            WriteError: the folder cannot be written.
        """
        write_text(self.record, self.request)
        try:
            remove_partial(self.path)
        except OSError as error:
            raise WriteError(f"cannot write {self.path}: {error.strerror or error}") from None

    def end(self) -> None:
        """Remove the record of finished work; repeated calls are harmless.

        A record in a subfolder of intermediate results is removed with that subfolder.
        """
        if self.record.parent == self.path:
            self.record.unlink(missing_ok=True)
        else:
            shutil.rmtree(self.record.parent, ignore_errors=True)
