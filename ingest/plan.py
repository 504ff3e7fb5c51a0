"""What a run of ``ingest`` was asked for, by which an interrupted one continues."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from ingest.options import IngestOptions
from ingest.split import Split
from scene.bundle.manifest import Manifest, read_json
from scene.bundle.scene import MANIFEST, Scene
from scene.colmap.structure_from_motion import Mapper
from scene.errors import InputError
from scene.storage.atomic import TEMPORARY_PREFIX
from scene.storage.resumable import ResumableFolder

WORK = f"{TEMPORARY_PREFIX}ingest"
"""The folder of intermediate results in that of an unfinished scene."""

_PLAN = "plan.json"


class Plan(BaseModel):
    """The request of a run. A folder that was begun with another request is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    size: int
    mapper: Mapper
    split: Split
    every: int
    camera: str | None
    gps: str | None
    poses: str | None = None
    gcp: str | None = None
    checks: tuple[str, ...] = ()
    photographs: dict[str, str]
    options: IngestOptions = IngestOptions()


def resumable(out: Path, plan: Plan) -> ResumableFolder:
    """Return the folder of a scene, whose record is the plan while the scene is unfinished."""

    def difference(record: Path) -> str | None:
        recorded = read_json(record, Plan, "plan of the unfinished scene")
        return None if recorded == plan else "photographs or options"

    request = plan.model_dump_json(indent=1, by_alias=True) + "\n"
    return ResumableFolder(out, out / WORK / _PLAN, request, difference)


def finished(out: Path, plan: Plan) -> bool:
    """Return whether the folder holds this very flight already; refuse any other content."""
    unfinished = resumable(out, plan)
    if (out / MANIFEST).is_file():
        if recorded_plan(Scene.open(out).manifest) != plan:
            raise InputError(
                f"{out} holds a scene of other photographs or options: choose another folder or "
                "remove it"
            )
        unfinished.end()  # a run killed at its very end left its folder of intermediate results
        return True
    if not unfinished.resume(
        lambda difference: (
            f"{out} holds an unfinished scene of other {difference}: choose another folder or "
            "remove it"
        )
    ):
        unfinished.require_empty("scene")
    return False


def recorded_plan(manifest: Manifest) -> Plan | None:
    """Return the plan that a scene was made by; None if it was not made of photographs.

    Options that came later than the scene had the effect of their defaults.
    """
    try:
        return Plan.model_validate(manifest.config)
    except ValidationError:
        return None
