"""Checks of a run's outputs before it starts."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.storage.atomic import TEMPORARY_PREFIX, require_regular

# A mark lies within this many bytes from the beginning of a file.
_HEAD_BYTES = 4096


@dataclass(frozen=True)
class OutputFile:
    """A file that a run writes.

    Attributes:
        path: file to write.
        mark: bytes among the first 4096 by which this program recognizes its own file. An existing
            file without them is not replaced unless it is empty. An empty mark allows to replace
            any file.
    """

    path: Path
    mark: bytes = b""


def check_outputs(
    outputs: Iterable[OutputFile | Path], inputs: Iterable[Path] = (), within: Path | None = None
) -> None:
    """Refuse outputs that would overwrite other files or cannot be written.

    Args:
        outputs: files that the run writes.
        inputs: files and folders that it reads.
        within: folder in which all outputs must lie; None for any.

    Raises:
        InputError: an output is an input, is another output, or lies outside ``within``.
        WriteError: an output exists and was not written by this program, or its folder cannot be
            written.
    """
    sources = list(inputs)
    claimed: set[Path] = set()
    for output in outputs:
        made = output if isinstance(output, OutputFile) else OutputFile(output)
        place = _place(made.path)
        if within is not None and not place.is_relative_to(_place(within)):
            raise InputError(f"{made.path} lies outside {within}: choose a plain file name")
        if place in claimed:
            raise InputError(f"{made.path} would be written twice: choose another name")
        claimed.add(place)
        for path in sources:
            if _same(place, path):
                raise InputError(f"{made.path} is read by this command: choose another output")
        require_regular(made.path)
        _require_ours(made)
        require_writable(place.parent)


def check_output_folder(folder: Path, inputs: Iterable[Path] = ()) -> None:
    """Refuse an output folder that is an input or cannot be written.

    Raises:
        InputError: the folder is one of the inputs.
        WriteError: the path is not a folder, or it cannot be written or made.
    """
    for path in inputs:
        if _same(_place(folder), path):
            raise InputError(f"{folder} is read by this command: choose another output")
    require_writable(folder)


def check_outside(outputs: Iterable[OutputFile], folder: Path) -> None:
    """Refuse outputs inside a folder of photographs, where they would be taken for input.

    Raises:
        InputError: an output lies there.
    """
    for output in outputs:
        if _place(output.path).is_relative_to(folder.resolve()):
            raise InputError(
                f"{output.path} lies in the folder of photographs: choose one outside it"
            )


def require_empty(folder: Path) -> None:
    """Refuse a folder that is not new or empty.

    Raises:
        InputError: the folder is not empty, or cannot be read.
    """
    try:
        occupied = folder.exists() and any(folder.iterdir())
    except OSError as error:
        raise InputError(f"cannot use the folder {folder}: {error.strerror}") from None
    if occupied:
        raise InputError(f"{folder} is not empty: choose another folder or remove it")


def require_writable(folder: Path) -> None:
    """Refuse a folder that cannot be written or created.

    Raises:
        WriteError: the folder cannot be written or created.
    """
    existing = folder
    while not os.path.lexists(existing) and existing != existing.parent:
        existing = existing.parent
    try:
        if not stat.S_ISDIR(existing.stat().st_mode):
            raise WriteError(f"cannot write {folder}: {existing} is not a folder")
        # Try it, because permissions do not show a read-only file system.
        trial = existing / f"{TEMPORARY_PREFIX}trial-{os.getpid()}"
        trial.mkdir(exist_ok=True)
        trial.rmdir()
    except WriteError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else None
        raise WriteError(f"cannot write {folder}: {reason or error}") from None


def require_name(name: str, what: str) -> None:
    """Refuse a word that cannot name a file or folder.

    Args:
        name: word that becomes part of a file name.
        what: noun for the word in the message.

    Raises:
        InputError: the name is empty, hidden, too long, not UTF-8, or holds a slash or a control
            character.
    """
    plain = name.isprintable() and not name.startswith(".") and not set(name) & set('/\\:*?"<>|')
    if not name or not plain or name != name.strip() or len(name.encode()) > 200:
        raise InputError(
            f"{what} {name!r} cannot name a file: use letters, digits, spaces, dots, - and _"
        )


def _place(path: Path) -> Path:
    """Return the absolute path of a file; its folder is resolved, the file itself is not."""
    try:
        return path.parent.resolve() / path.name if path.name else path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise WriteError(f"cannot write {path}: {error}") from None


def _same(place: Path, path: Path) -> bool:
    try:
        return place == _place(path) or (place.exists() and place.samefile(path))
    except (OSError, ValueError):
        return False


def _require_ours(output: OutputFile) -> None:
    if not output.mark or not output.path.exists():
        return
    try:
        with output.path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except OSError as error:
        raise WriteError(f"cannot write {output.path}: {error.strerror}") from None
    if head and output.mark not in head:
        raise foreign_file_error(output.path)


def foreign_file_error(path: Path) -> WriteError:
    """Return the error for an output path with a file of another program."""
    return WriteError(
        f"cannot write {path}: another file stands there: remove it or choose another output"
    )
