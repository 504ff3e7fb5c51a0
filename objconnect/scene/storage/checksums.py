"""``SHA256SUMS``: the digests of a published folder's files, as ``sha256sum -c`` reads them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from objconnect.scene.errors import InputError
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.files import is_safe_path, read_text

CHECKSUMS: Final = "SHA256SUMS"

_LINE: Final = re.compile(r"([0-9a-f]{64})  (.+)")


def write_checksums(folder: Path, known: Mapping[str, str] | None = None) -> None:
    """Write the digests of all other files in a folder, in the order of their names.

    Args:
        folder: the folder.
        known: digests that were computed before, by the path in the folder.

    Raises:
        InputError: a file cannot be read or written.
    """
    known = known or {}
    checksums = folder / CHECKSUMS
    files = [file for file in folder.rglob("*") if file.is_file() and file != checksums]
    names = sorted(file.relative_to(folder).as_posix() for file in files)
    lines = [f"{known.get(name) or sha256_of(folder / name)}  {name}\n" for name in names]
    write_text(checksums, "".join(lines))


def read_checksums(folder: Path) -> dict[str, str]:
    """Return the digests that ``SHA256SUMS`` lists by the path in the folder.

    Raises:
        InputError: the file is missing, damaged, or names a file outside the folder.
    """
    path = folder / CHECKSUMS
    digests: dict[str, str] = {}
    for number, line in enumerate(read_text(path, "list of digests").splitlines(), start=1):
        match = _LINE.fullmatch(line)
        if match is None or not is_safe_path(match[2]):
            raise InputError(f"{path}, line {number}: it is not DIGEST  FILE: download it again")
        digests[match[2]] = match[1]
    return digests
