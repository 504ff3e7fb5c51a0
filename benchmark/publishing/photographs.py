"""Unpack the photographs of shards into files, because methods read files.

The files are written once, to ``$XDG_CACHE_HOME/objconnect/photographs`` or
``~/.cache/objconnect/photographs``, in a folder named by the digests of the photographs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from filelock import FileLock

from benchmark.publishing.shards import read_shards
from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import atomic_folder
from objconnect.scene.storage.digests import digests_in, sha256
from objconnect.scene.storage.files import is_safe_path
from objconnect.scene.storage.user_cache import user_cache


def unpack_photographs(shards: Sequence[Path], expected: Mapping[str, str]) -> Path:
    """Return a folder with the photographs of shards, as their files were published.

    A folder of an earlier call is used if all photographs in it are intact.

    Args:
        shards: files that hold the rows of the photographs.
        expected: SHA-256 of each photograph by name.

    Raises:
        InputError: a name leads out of the folder, a shard is damaged, a photograph differs from
            its digest, or the folder cannot be written.
    """
    for name in expected:
        if not is_safe_path(name):
            raise InputError(f"{shards[0]}: photograph {name!r} leads out of the scene's folder")
    cache = user_cache()
    if cache is None:
        raise InputError("no home folder is known: set XDG_CACHE_HOME to a folder for photographs")
    target = cache / "photographs" / sha256(json.dumps(sorted(expected.items())))
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        lock = FileLock(target.with_suffix(".lock"))
        with lock:
            if not _is_intact(target, expected):
                _unpack(shards, expected, target)
    except OSError as error:
        raise WriteError(f"cannot write {target}: {error.strerror or error}") from None
    return target


def _is_intact(folder: Path, expected: Mapping[str, str]) -> bool:
    return folder.is_dir() and digests_in(folder, expected, "missing") == expected


def _unpack(shards: Sequence[Path], expected: Mapping[str, str], target: Path) -> None:
    """Write the photographs that are expected, each checked against its digest."""
    with (
        progress_bar("photographs", len(expected)) as advance,
        atomic_folder(target, tuple(expected)) as folder,
    ):
        written = 0
        for row in read_shards(shards, ("name", "image")):
            name, photograph = row["name"], (row["image"] or {}).get("bytes")
            if name not in expected:
                continue
            if photograph is None or sha256(photograph) != expected[name]:
                raise InputError(
                    f"{shards[0].parent}: photograph {name} differs from its digest: download the "
                    "data set again"
                )
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(photograph)
            written += 1
            advance(written)
        if written < len(expected):
            raise InputError(
                f"{shards[0].parent}: {len(expected) - written} of {len(expected)} photographs are "
                "in no shard: download the data set again"
            )
