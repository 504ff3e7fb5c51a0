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
# Largest size of a name that becomes part of a file name; file systems allow 255 with the suffix.
_NAME_BYTES = 200


@dataclass(frozen=True)
class OutputFile:
    """A file that a run writes.

    Attributes:
        path: file to write.
        mark: bytes among the first 4096 by which this program recognizes its own file. An existing
            file without them is not replaced unless it is empty. With an empty mark, any file is
            replaced.
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
        file = output if isinstance(output, OutputFile) else OutputFile(output)
        absolute = _absolute(file.path)
        if within is not None and not absolute.is_relative_to(_absolute(within)):
            raise InputError(f"{file.path} lies outside {within}: choose a plain file name")
        if absolute in claimed:
            raise InputError(f"{file.path} would be written twice: choose another name")
        claimed.add(absolute)
        for path in sources:
            if _is_same_file(absolute, path):
                raise InputError(f"{file.path} is read by this command: choose another output")
        require_regular(file.path)
        _require_ours(file)
        require_writable(absolute.parent)


def check_output_folder(folder: Path, inputs: Iterable[Path] = ()) -> None:
    """Refuse an output folder that is an input or cannot be written.

    Raises:
        InputError: the folder is one of the inputs.
        WriteError: the path is not a folder, or it cannot be written or made.
    """
    for path in inputs:
        if _is_same_file(_absolute(folder), path):
            raise InputError(f"{folder} is read by this command: choose another output")
    require_writable(folder)


def check_outside(outputs: Iterable[OutputFile], folder: Path) -> None:
    """Refuse outputs inside a folder of photographs, where they would be taken for input.

    Raises:
        InputError: an output lies there.
    """
    for output in outputs:
        if _absolute(output.path).is_relative_to(folder.resolve()):
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
    if not name.isprintable() or set(name) & set('/\\:*?"<>|'):
        raise InputError(
            f"{what} {name!r} cannot name a file: use letters, digits, spaces, dots, - and _"
        )
    if name.startswith(".") or name != name.strip():
        raise InputError(
            f"{what} {name!r} begins with a dot, or begins or ends with a space: leave that out"
        )
    if not 0 < len(name.encode()) <= _NAME_BYTES:
        raise InputError(f"{what} {name!r} cannot name a file: use 1 to {_NAME_BYTES} bytes")


def _absolute(path: Path) -> Path:
    """Return the absolute path of a file; its folder is resolved, the file itself is not."""
    try:
        return path.parent.resolve() / path.name if path.name else path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise WriteError(f"cannot write {path}: {error}") from None


def _is_same_file(absolute: Path, path: Path) -> bool:
    try:
        return absolute == _absolute(path) or (absolute.exists() and absolute.samefile(path))
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
        f"cannot write {path}: it is a file of another program: remove it or choose another output"
    )
