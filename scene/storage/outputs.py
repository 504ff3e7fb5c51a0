"""What a run may write, decided before it begins: the one place for every command."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from scene.errors import InputError, WriteError
from scene.storage.files import MARK, require_regular

# Among so many first bytes a file says who wrote it.
_HEAD = 4096


@dataclass(frozen=True)
class Output:
    """A file that a run writes.

    Attributes:
        path: of the file.
        mark: that every file which we write there has among its first 4096 bytes. A file without
            it, unless it is empty, is somebody else's and stays. Empty: any file there is ours.
    """

    path: Path
    mark: bytes = b""


def claim(
    outputs: Iterable[Output | Path], inputs: Iterable[Path] = (), within: Path | None = None
) -> None:
    """Refuse, before any work, outputs that would destroy something or cannot be written.

    Args:
        outputs: files that the run writes.
        inputs: files and folders that it reads.
        within: folder that all outputs must lie in.

    Raises:
        InputError: an output is an input, is another output, or lies outside ``within``.
        WriteError: something that is not a file of ours stands there, or the folder cannot be
            written.
    """
    read = list(inputs)
    claimed: set[Path] = set()
    for output in outputs:
        made = output if isinstance(output, Output) else Output(output)
        place = _place(made.path)
        if within is not None and not place.is_relative_to(_place(within)):
            raise InputError(f"{made.path} lies outside {within}: choose a plain file name")
        if place in claimed:
            raise InputError(f"{made.path} would be written twice: choose another name")
        claimed.add(place)
        for path in read:
            if _same(place, path):
                raise InputError(f"{made.path} is read by this command: choose another output")
        require_regular(made.path)
        _require_ours(made)
        require_writable(place.parent)


def claim_folder(folder: Path, inputs: Iterable[Path] = ()) -> None:
    """The same for a folder that a run writes files into.

    Raises:
        InputError: it is one of the inputs.
        WriteError: it is no folder, or cannot be written or made.
    """
    for path in inputs:
        if _same(_place(folder), path):
            raise InputError(f"{folder} is read by this command: choose another output")
    require_writable(folder)


def require_writable(folder: Path) -> None:
    """Refuse a folder that cannot be written, or made; nothing is left of the trial.

    Raises:
        WriteError: it cannot.
    """
    there = folder
    while not os.path.lexists(there) and there != there.parent:
        there = there.parent
    try:
        if not stat.S_ISDIR(there.stat().st_mode):
            raise WriteError(f"cannot write {folder}: {there} is not a folder")
        # Permissions alone do not say it: the file system may be read-only.
        trial = there / f"{MARK}trial-{os.getpid()}"
        trial.mkdir(exist_ok=True)
        trial.rmdir()
    except WriteError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else None
        raise WriteError(f"cannot write {folder}: {reason or error}") from None


def require_name(name: str, what: str) -> None:
    """Refuse a word that cannot be the name of a file or folder of ours.

    Args:
        name: to be part of a file's name.
        what: it names, for the message.

    Raises:
        InputError: it is empty, hidden, too long, not UTF-8, or holds a slash or a control
            character.
    """
    plain = name.isprintable() and not name.startswith(".") and not set(name) & set('/\\:*?"<>|')
    if not name or not plain or name != name.strip() or len(name.encode()) > 200:
        raise InputError(
            f"{what} {name!r} cannot name a file: use letters, digits, spaces, dots, - and _"
        )


def _place(path: Path) -> Path:
    """Where a file would lie: links in its folder are followed, the file itself is not."""
    try:
        return path.parent.resolve() / path.name if path.name else path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise WriteError(f"cannot write {path}: {error}") from None


def _same(place: Path, path: Path) -> bool:
    try:
        return place == _place(path) or (place.exists() and place.samefile(path))
    except (OSError, ValueError):
        return False


def _require_ours(output: Output) -> None:
    if not output.mark or not output.path.exists():
        return
    try:
        with output.path.open("rb") as stream:
            head = stream.read(_HEAD)
    except OSError as error:
        raise WriteError(f"cannot write {output.path}: {error.strerror}") from None
    if head and output.mark not in head:
        raise another_file(output.path)


def another_file(path: Path) -> WriteError:
    """What to raise where somebody else's file stands."""
    return WriteError(
        f"cannot write {path}: another file stands there: remove it or choose another output"
    )
