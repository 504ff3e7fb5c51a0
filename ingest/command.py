"""The command ``ingest``, which makes a scene of photographs and resumes interrupted runs."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from ingest.adjustment import adjust
from ingest.attitude import turned_over
from ingest.georegister import georegister
from ingest.neighbours import choose_pairs
from ingest.options import IngestOptions
from ingest.outputs import write_lists, write_measurements
from ingest.photographs import SESSION, Flight, photographs_of, read_flight
from ingest.picture import draw
from ingest.positions import FEWEST, local, with_positions
from ingest.report import REPORT, AttitudeFindings, IngestReport, make_report
from ingest.split import Split, queries_of
from scene.bundle.manifest import Manifest, Session, read_json, write_json
from scene.bundle.scene import COVISIBILITY, FEATURES, MANIFEST, MAP_FILES, Scene, finish_scene
from scene.colmap.database import MatchingJob, match_photographs
from scene.colmap.sift import SiftOptions
from scene.colmap.structure_from_motion import Mapper, map_photographs
from scene.colmap.triangulation import triangulate_matched
from scene.errors import InputError, WriteError
from scene.geometry.camera import Camera
from scene.geometry.geodesy import Geodetic
from scene.maps.colmap_files import read_model
from scene.maps.features import write_features
from scene.maps.photographs import Photograph, PosedImage
from scene.maps.sparse_map import SparseMap
from scene.runtime.escaping import for_terminal
from scene.runtime.progress import progress_bar
from scene.storage.atomic import TEMPORARY_PREFIX, atomic_folder, remove_owned
from scene.storage.files import sha256_of
from scene.storage.images import read_rgb, write_resized
from scene.storage.locks import write_lock
from scene.storage.resumable import ResumableFolder

_WORK = f"{TEMPORARY_PREFIX}ingest"
_PLAN = "plan.json"
_TURNED = "turned.json"
_DATABASE = Path("database.db")
_DEFAULTS: Final = IngestOptions()


class _Plan(BaseModel):
    """The request of a run. A folder that was begun with another request is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    size: int
    mapper: Mapper
    split: Split
    every: int
    camera: str | None
    gps: str | None
    photographs: dict[str, str]
    options: IngestOptions = IngestOptions()


@dataclass(frozen=True)
class _Source:
    """What a scene is made of.

    Attributes:
        folder: folder of the photographs.
        flight: its photographs, and the files that are left out.
        taken: the photographs as structure from motion takes them.
        fixes: measured positions (3,) by name, world metres.
        queries: names of the queries.
        plan: what was asked for.
    """

    folder: Path
    flight: Flight
    taken: Sequence[Photograph]
    fixes: Mapping[str, NDArray[np.float64]]
    queries: set[str]
    plan: _Plan


class _Turned(BaseModel):
    """Names of the photographs that are rotated by 180 degrees in the scene."""

    names: tuple[str, ...]


# More than six parameters: they are the options of the command ``ingest``.
def ingest(
    photographs: Path,
    out: Path,
    *,
    gps: Path | None = None,
    camera: Camera | None = None,
    size: int = 1600,
    mapper: Mapper = "incremental",
    split: Split = "photo",
    every: int = 4,
    options: IngestOptions = _DEFAULTS,
) -> IngestReport:
    """Make a scene of a folder of geotagged JPEGs, or continue an interrupted run.

    Poses come from structure from motion of all photographs together, georegistered by GPS. The map
    is triangulated again from its own photographs.

    Args:
        photographs: folder of the photographs, with sub-folders.
        out: new folder, or one left by a run of the same photographs and options.
        gps: table of positions instead of those in EXIF, see ``with_positions``.
        camera: calibration of all photographs; None takes it from EXIF.
        size: longest side of the photographs in the scene, pixels; larger ones are reduced.
        mapper: "incremental" or "global" structure from motion.
        split: queries are every ``every``-th "photo" or flight "line", or "none".
        every: see ``split``.
        options: which photographs are matched, and when GPS and gimbals are believed.

    Raises:
        InputError: fewer than three photographs can be read, have positions or overlap; ``out``
            holds other files, cannot be written or is being written by another run.
    """
    if photographs.resolve() in (out.resolve(), *out.resolve().parents):
        raise InputError(f"{out} lies in the folder of photographs: choose one outside it")
    flight = read_flight(photographs)
    if gps is not None:
        flight = with_positions(flight, gps)
    _require(flight, photographs)
    plan = _Plan(
        size=size,
        mapper=mapper,
        split=split,
        every=every,
        camera=None if camera is None else str(camera),
        gps=None if gps is None else sha256_of(gps),
        photographs={image.file: image.sha256 for image in flight.images},
        options=options,
    )
    with write_lock(out):
        return _ingest(photographs, out, flight, camera, plan)


def _ingest(
    photographs: Path, out: Path, flight: Flight, camera: Camera | None, plan: _Plan
) -> IngestReport:
    origin, fixes = local(flight.images)
    names, options = [image.name for image in flight.images], plan.options
    queries = queries_of(names, fixes, plan.split, plan.every, options.line_turn_deg)
    taken = photographs_of(flight.images, plan.size, camera, options.guessed_focal)
    if _finished(out, plan):
        return read_json(out / REPORT, IngestReport, "report of the ingested flight")
    unfinished = _resumable(out, plan)
    unfinished.begin()
    try:
        report = _build(out, _Source(photographs, flight, taken, fixes, queries, plan))
    except WriteError:
        raise  # the same command continues when there is room
    except InputError:
        # These photographs make no scene, so nothing is kept for a later run.
        remove_owned(out, _owned(flight))
        raise
    finish_scene(out, _manifest(plan, origin))
    unfinished.end()
    return report


def _owned(flight: Flight) -> set[str]:
    """Return the files that we write into the folder of a scene, for ``remove_owned``."""
    copies = [f"sessions/{image.name}" for image in flight.images]
    frames = f"sessions/{SESSION}/frames.h5"
    lists = ["splits.json", "objects.json", COVISIBILITY, REPORT.name, "pictures/ingest.png"]
    return {*copies, frames, *lists, *(f"map/{file}" for file in MAP_FILES)}


def _build(out: Path, source: _Source) -> IngestReport:
    """Write everything of the scene but its manifest."""
    taken, fixes, queries = source.taken, source.fixes, source.queries
    options = source.plan.options
    flight, model_path, turned = _structure(out, source)
    times = {image.name: image.exif.time.timestamp() for image in flight.images if image.exif.time}
    adjusted = adjust(model_path, taken, fixes, times, out / _WORK, options)
    model, images = adjusted.model, flight.images
    wrong_attitudes = write_measurements(out, adjusted, images, fixes, queries, options)
    sparse_map = _triangulate(out, model, queries)
    write_lists(out, model, images, queries, options.covisibility_points)
    over = [image.file for image in images if image.name in turned]
    findings = AttitudeFindings(wrong_attitudes, over)
    report = make_report(taken, flight, adjusted, fixes, sparse_map, findings)
    write_json(out / REPORT, report)
    draw(
        out / "pictures" / "ingest.png",
        f"{for_terminal(out.resolve().name)}: {report.registered} photographs, "
        f"{report.points} points",
        adjusted,
        [image.name for image in images],
        queries,
        fixes,
    )
    for name in {image.name for image in source.flight.images} - model.images.keys():
        (out / "sessions" / name).unlink(missing_ok=True)
    return report


def _structure(out: Path, source: _Source) -> tuple[Flight, Path, set[str]]:
    """Return the photographs of one model, the folder of the model, and the rotated photographs."""
    fixes, options = source.fixes, source.plan.options
    known = out / _WORK / _TURNED
    turned = set(read_json(known, _Turned, "turned photographs").names) if known.exists() else set()
    placed = _place(source.flight, source.folder, out, source.plan.size, turned)
    _require(placed, source.folder)
    files = {image.name: image.file for image in placed.images}
    there = [photograph for photograph in source.taken if photograph.name in files]
    _match(there, fixes, options, out)
    model_path, elsewhere = _map(there, out, source.plan.mapper)
    if not turned:
        raw = read_model(model_path)
        where = georegister(raw, fixes, options.placement)
        turned = turned_over(raw, where, placed.images, options.max_attitude_error_deg)
        if turned:
            # Their features belong to the unturned pictures, so the reconstruction starts again.
            for name in turned:
                (out / "sessions" / name).unlink()
            for path in (out / _WORK).glob(f"{_DATABASE.stem}*"):
                path.unlink()
            shutil.rmtree(model_path.parent)
            write_json(known, _Turned(names=tuple(sorted(turned))))
            return _structure(out, source)
    return (
        placed.without({files[name]: reason for name, reason in elsewhere.items()}),
        model_path,
        turned,
    )


def _require(flight: Flight, folder: Path) -> None:
    """Refuse a flight with too few photographs for a scene."""
    if len(flight.images) < FEWEST:
        reasons = "".join(f"; {file}: {why}" for file, why in list(flight.left_out.items())[:3])
        raise InputError(
            f"{folder} has {len(flight.images)} usable photographs, {FEWEST} are the fewest that "
            f"make a scene{reasons}"
        )


def _resumable(out: Path, plan: _Plan) -> ResumableFolder:
    """Return the folder of a scene, whose record is the plan while the scene is unfinished."""

    def difference(record: Path) -> str | None:
        recorded = read_json(record, _Plan, "plan of the unfinished scene")
        return None if recorded == plan else "photographs or options"

    request = plan.model_dump_json(indent=1, by_alias=True) + "\n"
    return ResumableFolder(out, out / _WORK / _PLAN, request, difference)


def _finished(out: Path, plan: _Plan) -> bool:
    """Return whether the folder holds this very flight already; refuse any other content."""
    unfinished = _resumable(out, plan)
    if (out / MANIFEST).is_file():
        if _recorded_plan(Scene.open(out).manifest) != plan:
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


def _recorded_plan(manifest: Manifest) -> _Plan | None:
    """Return the plan that a scene was made by; None if it was not made of photographs.

    Options that came later than the scene had the effect of their defaults.
    """
    try:
        return _Plan.model_validate(manifest.config)
    except ValidationError:
        return None


def _place(flight: Flight, folder: Path, out: Path, size: int, turned: set[str]) -> Flight:
    """Copy photographs into the scene, rotating some; leave damaged ones out."""
    damaged = {}
    with progress_bar("copy photographs", len(flight.images)) as advance:
        for done, image in enumerate(flight.images, 1):
            target = out / "sessions" / image.name
            if not target.is_file():
                try:
                    read_rgb(folder / image.file)
                except InputError as error:
                    damaged[image.file] = str(error)
                else:
                    write_resized(folder / image.file, target, size, over=image.name in turned)
            advance(done)
    return flight.without(damaged)


def _match(
    taken: Sequence[Photograph],
    fixes: Mapping[str, NDArray[np.float64]],
    options: IngestOptions,
    out: Path,
) -> None:
    pairs = choose_pairs([photograph.name for photograph in taken], fixes, options.pairs)
    with progress_bar("extract and match", len(taken) + len(pairs)) as advance:
        job = MatchingJob(out / "sessions", pairs, SiftOptions(), matching=options.matching)
        match_photographs(job, taken, out / _WORK / _DATABASE, advance)


def _map(taken: Sequence[Photograph], out: Path, mapper: Mapper) -> tuple[Path, dict[str, str]]:
    """Return the model of most photographs, and the reasons why others are not in it."""
    models = out / _WORK / "models"
    with progress_bar("map", len(taken)) as advance, atomic_folder(models) as folder:
        models_by_size = map_photographs(
            out / "sessions", taken, out / _WORK / _DATABASE, folder, mapper, advance
        )
        members = [read_model(path).names for path in models_by_size]
    if not members or len(members[0]) < FEWEST:
        raise InputError(
            f"no {FEWEST} of the {len(taken)} photographs hang together: they need overlap and "
            "texture"
        )
    reasons = {photograph.name: "not registered: too few matches" for photograph in taken}
    for names in reversed(members):  # a photograph may be in several
        reasons |= dict.fromkeys(names, f"in another model, of {len(names)} photographs")
    return models / models_by_size[0].name, {
        n: why for n, why in reasons.items() if n not in members[0]
    }


def _triangulate(out: Path, model: SparseMap, queries: set[str]) -> SparseMap:
    images = [
        PosedImage(name, model.images[name].camera, model.images[name].cam_from_world)
        for name in model.names
        if name not in queries
    ]
    with atomic_folder(out / "map", MAP_FILES) as folder:
        sparse_map, features = triangulate_matched(
            out / "sessions", images, out / _WORK / _DATABASE, folder
        )
        write_features(folder / FEATURES, features)
    return sparse_map


def _manifest(plan: _Plan, origin: Geodetic) -> Manifest:
    return Manifest(
        versions={n: version(n) for n in ("objconnect", "pycolmap", "numpy", "pillow", "h5py")},
        preset=None,
        seed=None,
        config=plan.model_dump(mode="json"),
        origin=origin,
        reference="sfm",
        sessions={SESSION: Session(condition="same-flight", flight="photographs", role="both")},
        sha256={},
    )
