"""The record of photographs that are rotated by 180 degrees in an unfinished scene."""

from __future__ import annotations

import shutil
from collections.abc import Collection
from pathlib import Path
from typing import Final

from pydantic import BaseModel

from objconnect.ingestion.plan import DATABASE, WORK
from objconnect.scene.bundle.manifest import read_json, write_json

_RECORD: Final = "turned.json"


class _Turned(BaseModel):
    """Names of the photographs that are rotated by 180 degrees in the scene."""

    names: tuple[str, ...]


def read_turned(out: Path) -> set[str]:
    """Return the names of the photographs of an unfinished scene that are rotated."""
    record = out / WORK / _RECORD
    return set(read_json(record, _Turned, "turned photographs").names) if record.exists() else set()


def begin_again(out: Path, turned: Collection[str], models: Path) -> None:
    """Remove what was computed from photographs that are to be rotated, and record their names.

    Their features belong to the unturned pictures, so the reconstruction starts again.

    Args:
        out: folder of the unfinished scene.
        turned: names of the photographs.
        models: folder of the reconstruction.
    """
    for name in turned:
        (out / "sessions" / name).unlink()
    for path in (out / WORK).glob(f"{DATABASE.stem}*"):
        path.unlink()
    shutil.rmtree(models)
    write_json(out / WORK / _RECORD, _Turned(names=tuple(sorted(turned))))
