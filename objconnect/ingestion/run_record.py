"""The record of a run of ``ingest``: inputs and options, by which an interrupted run resumes."""

from __future__ import annotations

from collections.abc import Callable, Collection
from importlib.metadata import version
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from objconnect.ingestion.options import IngestOptions
from objconnect.ingestion.report import REPORT, IngestReport
from objconnect.ingestion.split import Split
from objconnect.scene.bundle.manifest import Manifest, Session, read_json
from objconnect.scene.bundle.scene import MANIFEST, Scene, finish_scene
from objconnect.scene.colmap.structure_from_motion import Mapper
from objconnect.scene.config import take_recorded
from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.storage.atomic import TEMPORARY_PREFIX, remove_owned
from objconnect.scene.storage.resumable import ResumableFolder

WORK = f"{TEMPORARY_PREFIX}ingest"
"""Subfolder of an unfinished scene for intermediate results."""

DATABASE = Path("database.db")
"""COLMAP's database of features and matches, in ``WORK``."""

_RECORD = "record.json"


class RunRecord(BaseModel):
    """The inputs and options of a run. A folder with another record is refused.

    ``gps``, ``poses`` and ``gcp`` are digests of files, ``photographs`` holds digests by file.
    ``base`` is the digest of the scene that photographs are added to, and ``known`` holds the
    photographs of that scene: file by digest.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    size: int
    mapper: Mapper
    split: Split
    every: int
    camera: str | None = None
    gps: str | None = None
    poses: str | None = None
    gcp: str | None = None
    checks: tuple[str, ...] = ()
    base: str | None = None
    known: dict[str, str] = {}
    photographs: dict[str, str] = {}
    options: IngestOptions = IngestOptions()

    @field_validator("options", mode="before")
    @classmethod
    def _read_any_version(cls, options: object) -> object:
        return take_recorded(IngestOptions, options) if isinstance(options, dict) else options


def open_unfinished(out: Path, record: RunRecord) -> ResumableFolder:
    """Return the folder of a scene, which stores the record while it is unfinished."""

    def difference(path: Path) -> str | None:
        recorded = read_json(path, RunRecord, "record of the unfinished scene")
        return None if recorded == record else "photographs or options"

    text = record.model_dump_json(indent=1, by_alias=True) + "\n"
    return ResumableFolder(out, out / WORK / _RECORD, text, difference)


def is_finished(out: Path, record: RunRecord) -> bool:
    """Return whether a folder holds the finished scene of a record; refuse other content."""
    unfinished = open_unfinished(out, record)
    if (out / MANIFEST).is_file():
        if read_run_record(Scene.open(out).manifest) != record:
            raise InputError(
                f"{out} holds a scene of other photographs or options: choose another folder or "
                "remove it"
            )
        unfinished.end()  # a run killed just before its end leaves intermediate results
        return True
    if not unfinished.can_resume(
        lambda difference: (
            f"{out} holds an unfinished scene of other {difference}: choose another folder or "
            "remove it"
        )
    ):
        unfinished.require_empty("scene")
    return False


def flight_manifest(record: RunRecord, origin: Geodetic, session: str) -> Manifest:
    """Return the manifest (``scene.json``) of a scene of one flight, without digests."""
    return Manifest(
        versions={n: version(n) for n in ("objconnect", "pycolmap", "numpy", "pillow", "h5py")},
        preset=None,
        seed=None,
        config=record.model_dump(mode="json"),
        origin=origin,
        reference="sfm",
        sessions={session: Session(condition="same-flight", flight="photographs", role="both")},
        sha256={},
    )


def make_scene(
    out: Path,
    record: RunRecord,
    build: Callable[[], IngestReport],
    owned: Collection[str],
    manifest: Manifest,
) -> IngestReport:
    """Make or continue the scene of a record; return the report of a finished one.

    Args:
        out: Folder of the scene.
        record: The inputs and options.
        build: Writes all files of the scene except its manifest.
        owned: Files that ``build`` may write, for ``remove_owned``.
        manifest: The manifest without digests, and without georeference, which ``build`` reports.

    Raises:
        InputError: The folder holds something else, or ``build`` raises it.
    """
    if is_finished(out, record):
        return read_json(out / REPORT, IngestReport, "report of the ingested flight")
    unfinished = open_unfinished(out, record)
    unfinished.begin()
    try:
        report = build()
    except WriteError:
        raise  # a later run continues when the disk has room
    except InputError:
        # No scene can be made of these photographs, so a later run has nothing to continue.
        remove_owned(out, owned)
        raise
    finish_scene(out, manifest.model_copy(update={"georeference": report.georeference}))
    unfinished.end()
    return report


def read_run_record(manifest: Manifest) -> RunRecord | None:
    """Return the record of a scene; None if it was not made from photographs.

    Options that did not exist when the scene was made have their defaults.
    """
    try:
        return RunRecord.model_validate(manifest.config)
    except ValidationError:
        return None
