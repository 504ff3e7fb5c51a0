"""The command ``ingest``, which makes a scene of photographs and resumes interrupted runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.addition import add_photographs
from objconnect.ingestion.adjustment import Adjusted, adjust
from objconnect.ingestion.attitude import find_upside_down
from objconnect.ingestion.control import fit_to_control
from objconnect.ingestion.control_points import ControlPoint, read_control_points
from objconnect.ingestion.georeference import Receiver, georeference_of
from objconnect.ingestion.georegister import georegister
from objconnect.ingestion.imported_poses import Given, read_given, triangulate_imported
from objconnect.ingestion.neighbours import choose_pairs
from objconnect.ingestion.options import IngestOptions
from objconnect.ingestion.outputs import (
    FRAMES,
    list_own_files,
    write_lists,
    write_map,
    write_measurements,
)
from objconnect.ingestion.photographs import (
    SESSION,
    Flight,
    copy_photographs,
    photographs_of,
    read_flight,
    read_sigmas,
    warn_of_doubts,
)
from objconnect.ingestion.picture import PICTURE, draw
from objconnect.ingestion.plan import DATABASE, WORK, Plan, flight_manifest, make_scene
from objconnect.ingestion.positions import FEWEST, local, with_positions
from objconnect.ingestion.report import REPORT, Findings, IngestReport, make_report
from objconnect.ingestion.rotated_photographs import begin_again, read_turned
from objconnect.ingestion.split import Split, queries_of
from objconnect.scene.bundle.manifest import write_json
from objconnect.scene.colmap.database import MatchingJob, match_photographs
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.colmap.structure_from_motion import Mapper, map_photographs
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.imports.poses import Frame
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.photographs import Photograph
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import atomic_folder
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.locks import write_lock

_DEFAULTS: Final = IngestOptions()


@dataclass(frozen=True)
class _Source:
    """What a scene is made of.

    Attributes:
        folder: folder of the photographs.
        flight: its photographs, and the files that are left out.
        taken: the photographs as structure from motion takes them.
        origin: place of the world's origin.
        fixes: measured positions (3,) by name, world metres.
        queries: names of the queries.
        plan: what was asked for.
        given: poses of another program; None for structure from motion.
        control: ground control points, with marks in the photographs of the folder.
    """

    folder: Path
    flight: Flight
    taken: Sequence[Photograph]
    origin: Geodetic
    fixes: Mapping[str, NDArray[np.float64]]
    queries: set[str]
    plan: Plan
    given: Given | None
    control: Sequence[ControlPoint]


# More than six parameters: they are the options of the command ``ingest``.
def ingest(
    photographs: Path,
    out: Path,
    *,
    gps: Path | None = None,
    poses: Path | None = None,
    poses_frame: Frame | None = None,
    gcp: Path | None = None,
    checks: Sequence[str] = (),
    add: Path | None = None,
    camera: Camera | None = None,
    size: int = 1600,
    mapper: Mapper = "incremental",
    split: Split = "photo",
    every: int = 4,
    options: IngestOptions = _DEFAULTS,
) -> IngestReport:
    """Make a scene of a folder of geotagged JPEGs, or continue an interrupted run.

    Poses come from structure from motion of all photographs together, georegistered by GPS, or from
    a file of another program. The map is triangulated again from its own photographs.

    Args:
        photographs: folder of the photographs, with sub-folders.
        out: new folder, or one left by a run of the same photographs and options.
        gps: table of positions instead of those in EXIF, see ``with_positions``.
        poses: poses and cameras of another program, see ``scene.imports``; photographs without a
            pose are left out.
        poses_frame: frame of ``poses``, where the file leaves it open.
        gcp: list of ground control points, see ``control_points``. With ``poses``, which stay as
            they are, all points are check points.
        checks: names of points that are only compared.
        add: finished scene to which the photographs are added, see ``add_photographs``; it stays as
            it is, and ``out`` becomes a scene of both.
        camera: calibration of all photographs; None takes it from ``poses`` or EXIF.
        size: longest side of the photographs in the scene, pixels; larger ones are reduced.
        mapper: "incremental" or "global" structure from motion.
        split: queries are every ``every``-th "photo" or flight "line", or "none".
        every: see ``split``.
        options: which photographs are matched, and how exact receiver and ground control are.

    Raises:
        InputError: fewer than three photographs can be read, have positions or overlap; ``out``
            holds other files, cannot be written or is being written by another run; or as
            ``add_photographs``.
    """
    if photographs.resolve() in (out.resolve(), *out.resolve().parents):
        raise InputError(f"{out} lies in the folder of photographs: choose one outside it")
    if add is not None:
        other = (poses, poses_frame, gcp)
        if any(each is not None for each in other) or checks or mapper != "incremental":
            raise InputError(
                "added photographs are registered in the map of their scene: leave out --poses, "
                "--poses-frame, --gcp, --gcp-check and --mapper"
            )
        asked = Plan(size=size, mapper=mapper, split=split, every=every, options=options)
        return add_photographs(photographs, add, out, asked, gps, camera)
    if poses is None and poses_frame is not None:
        raise InputError("--poses-frame states the frame of a file of poses: give --poses")
    flight = read_flight(photographs)
    if gps is not None:
        flight = with_positions(flight, gps)
    warn_of_doubts(flight, with_lenses=camera is None and poses is None)
    given = None
    if poses is not None:
        flight, given = read_given(poses, flight, size, camera, poses_frame)
    _require(flight, photographs)
    if checks and gcp is None:
        raise InputError("check points are points of a list: give --gcp")
    control = [] if gcp is None else read_control_points(gcp, flight, size, checks)
    plan = Plan(
        size=size,
        mapper=mapper,
        split=split,
        every=every,
        camera=None if camera is None else str(camera),
        gps=None if gps is None else sha256_of(gps),
        poses=None if given is None else given.sha256,
        gcp=None if gcp is None else sha256_of(gcp),
        checks=tuple(sorted(set(checks))),
        photographs={image.file: image.sha256 for image in flight.images},
        options=options,
    )
    source = _source(photographs, flight, camera, given, control, plan)
    with write_lock(out):
        return _ingest(out, source)


def _source(
    photographs: Path,
    flight: Flight,
    camera: Camera | None,
    given: Given | None,
    control: Sequence[ControlPoint],
    plan: Plan,
) -> _Source:
    """Return what a scene is made of; only the photographs themselves are still unread."""
    origin, fixes = local(flight.images, None if given is None else given.origin)
    names = [image.name for image in flight.images]
    course = fixes if given is None or given.origin is None else given.centres
    queries = queries_of(names, course, plan.split, plan.every)
    if given is None:
        taken = photographs_of(flight.images, plan.size, camera)
    else:
        taken = given.photographs()
        control = [replace(point, check=True) for point in control]
    return _Source(photographs, flight, taken, origin, fixes, queries, plan, given, control)


def _ingest(out: Path, source: _Source) -> IngestReport:
    return make_scene(
        out,
        source.plan,
        lambda: _build(out, source),
        list_own_files(source.flight.images, SESSION),
        flight_manifest(source.plan, source.origin, SESSION),
    )


def _build(out: Path, source: _Source) -> IngestReport:
    """Write everything of the scene but its manifest."""
    taken, fixes, queries = source.taken, source.fixes, source.queries
    options = source.plan.options
    if source.given is not None:
        flight, adjusted, turned = _use_imported_poses(out, source, source.given)
    else:
        flight, model_path, turned = _structure(out, source)
        times = {i.name: i.exif.time.timestamp() for i in flight.images if i.exif.time}
        adjusted = adjust(model_path, taken, fixes, times, out / WORK)
    points = [_follow_rotation(point, turned, taken) for point in source.control]
    adjusted, residuals = fit_to_control(
        adjusted, points, source.origin, taken, out / WORK, options
    )
    model, images = adjusted.model, flight.images
    frames = out / "sessions" / SESSION / FRAMES
    wrong_attitudes = write_measurements(frames, adjusted, images, fixes, queries)
    sparse_map = write_map(out, model, queries, out / WORK / DATABASE)
    write_lists(out, model, images, queries)
    over = [image.file for image in images if image.name in turned]
    receiver = Receiver(fixes, {} if source.plan.gps is not None else read_sigmas(images))
    placed = georeference_of(model, adjusted.placed, receiver, residuals, options)
    findings = Findings(wrong_attitudes, over, residuals, placed)
    report = make_report(taken, flight, adjusted, fixes, sparse_map, findings)
    write_json(out / REPORT, report)
    draw(
        out / PICTURE,
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


def _follow_rotation(
    point: ControlPoint, turned: set[str], taken: Sequence[Photograph]
) -> ControlPoint:
    """Return a point with its marks in photographs as they are in the scene, where some are
    rotated."""
    size = {p.name: np.array([p.camera.width, p.camera.height]) for p in taken}
    marks = {name: size[name] - xy if name in turned else xy for name, xy in point.marks.items()}
    return replace(point, marks=marks)


def _use_imported_poses(
    out: Path, source: _Source, given: Given
) -> tuple[Flight, Adjusted, set[str]]:
    """Return the photographs, their model with the given poses, and no rotated photographs."""
    placed = copy_photographs(source.flight, source.folder, out / "sessions", source.plan.size, ())
    _require(placed, source.folder)
    there = [image.name for image in placed.images]
    taken = [photograph for photograph in source.taken if photograph.name in set(there)]
    options, database = source.plan.options, out / WORK / DATABASE
    _match(taken, given.centres, options, out)
    adjusted = triangulate_imported(given, there, source.fixes, out / "sessions", database)
    return placed, adjusted, set()


def _structure(out: Path, source: _Source) -> tuple[Flight, Path, set[str]]:
    """Return the photographs of one model, the folder of the model, and the rotated photographs."""
    fixes, options = source.fixes, source.plan.options
    turned = read_turned(out)
    placed = copy_photographs(
        source.flight, source.folder, out / "sessions", source.plan.size, turned
    )
    _require(placed, source.folder)
    files = {image.name: image.file for image in placed.images}
    there = [photograph for photograph in source.taken if photograph.name in files]
    _match(there, fixes, options, out)
    model_path, elsewhere = _map(there, out, source.plan.mapper)
    if not turned:
        raw = read_model(model_path)
        where = georegister(raw, fixes)
        turned = find_upside_down(raw, where, placed.images)
        if turned:
            begin_again(out, turned, model_path.parent)
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


def _match(
    taken: Sequence[Photograph],
    fixes: Mapping[str, NDArray[np.float64]],
    options: IngestOptions,
    out: Path,
) -> None:
    pairs = choose_pairs([photograph.name for photograph in taken], fixes, options)
    with progress_bar("extract and match", len(taken) + len(pairs)) as advance:
        job = MatchingJob(out / "sessions", pairs, SiftOptions())
        match_photographs(job, taken, out / WORK / DATABASE, advance)


def _map(taken: Sequence[Photograph], out: Path, mapper: Mapper) -> tuple[Path, dict[str, str]]:
    """Return the model of most photographs, and the reasons why others are not in it."""
    models = out / WORK / "models"
    with progress_bar("map", len(taken)) as advance, atomic_folder(models) as folder:
        models_by_size = map_photographs(
            out / "sessions", taken, out / WORK / DATABASE, folder, mapper, advance
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
