"""The record of virtual views: inputs and options, by which an interrupted run resumes."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from objconnect.ingestion.virtual.options import ViewOptions
from objconnect.scene.bundle.georeference import Georeference
from objconnect.scene.bundle.manifest import read_json
from objconnect.scene.bundle.scene import MANIFEST, Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.storage.atomic import TEMPORARY_PREFIX
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.records import Record
from objconnect.scene.storage.resumable import ResumableFolder

_RECORD: Final = f"{TEMPORARY_PREFIX}orthophoto.json"


class SourceFile(Record):
    """A file that a data set was made of: its name and digest."""

    file: str
    sha256: str

    @staticmethod
    def of(path: Path) -> SourceFile:
        """Return the record of a file.

        Raises:
            InputError: the path is not a regular file.
        """
        return SourceFile(file=path.name, sha256=sha256_of(path))


class ViewsRecord(Record):
    """The inputs and options of a scene of virtual views. A folder with another record is refused.

    ``scene.json`` has it as configuration.

    Attributes:
        orthophoto: file of the colours.
        dsm: surface model.
        undulation: height of the geoid that is added to its heights, metres.
        views: altitude, overlap, tilt and size of the views.
        origin: origin of the world; None chooses it from the files.
        georeference: absolute accuracy of the files; None if unknown.
        method: method of ``map --ortho`` that builds the map; None for a scene without a map.
    """

    orthophoto: SourceFile
    dsm: SourceFile
    undulation: float
    views: ViewOptions
    origin: Geodetic | None
    georeference: Georeference | None
    method: str | None


def open_unfinished(out: Path, record: ViewsRecord) -> ResumableFolder:
    """Return the folder of a scene, which stores the record until all views are rendered."""

    def difference(path: Path) -> str | None:
        recorded = read_json(path, ViewsRecord, "record of the unfinished scene")
        return None if recorded == record else "files or options"

    return ResumableFolder(out, out / _RECORD, record.model_dump_json(), difference)


def find_finished(out: Path, record: ViewsRecord) -> Scene | None:
    """Return the scene of a record with all views; None if views are missing.

    Raises:
        InputError: ``out`` holds anything but this scene or a part of it.
    """
    unfinished = open_unfinished(out, record)
    if (out / MANIFEST).is_file():
        scene = Scene.open(out)
        if scene.manifest.config != record.model_dump(mode="json"):
            raise InputError(
                f"{out} holds a scene of other files or options: choose another folder or remove it"
            )
        unfinished.end()  # a run killed just before its end leaves its record
        return scene
    if not unfinished.can_resume(
        lambda difference: (
            f"{out} holds an unfinished scene of other {difference}: choose another folder or "
            "remove it"
        )
    ):
        unfinished.require_empty("scene")
    return None
