"""Record which photographs of an unfinished scene are rotated by 180 degrees."""

from __future__ import annotations

import shutil
from collections.abc import Collection
from pathlib import Path
from typing import Final

from pydantic import BaseModel

from objconnect.ingestion.run_record import DATABASE, WORK
from objconnect.scene.bundle.manifest import read_json, write_json

_RECORD: Final = "rotated.json"


class _Rotated(BaseModel):
    """Names of the photographs that the scene rotates by 180 degrees."""

    names: tuple[str, ...]


def read_rotated(out: Path) -> set[str]:
    """Return the names of the photographs of an unfinished scene that are rotated."""
    record = out / WORK / _RECORD
    if not record.exists():
        return set()
    return set(read_json(record, _Rotated, "rotated photographs").names)


def discard_unrotated(out: Path, names: Collection[str], models: Path) -> None:
    """Discard unrotated photographs and the results from them, and record which must be rotated.

    Features belong to the pictures before the rotation, so the reconstruction starts again.

    Args:
        out: folder of the unfinished scene.
        names: names of the photographs that must be rotated.
        models: folder of the reconstruction.
    """
    for name in names:
        (out / "sessions" / name).unlink()
    for path in (out / WORK).glob(f"{DATABASE.stem}*"):
        path.unlink()
    shutil.rmtree(models)
    write_json(out / WORK / _RECORD, _Rotated(names=tuple(sorted(names))))
