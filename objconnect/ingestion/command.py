"""The command ``ingest``: make a scene (poses and a map) from photographs, or resume a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.addition import add_photographs
from objconnect.ingestion.adjustment import AdjustedModel, adjust
from objconnect.ingestion.attitude import find_upside_down
from objconnect.ingestion.control import fit_to_control
from objconnect.ingestion.control_points import ControlPoint, read_control_points
from objconnect.ingestion.georeference import GpsFixes, estimate_georeference
from objconnect.ingestion.georegister import georegister
from objconnect.ingestion.imported_poses import (
    ImportedPoses,
    read_imported,
    triangulate_imported,
)
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
    make_photographs,
    read_flight,
    read_sigmas,
    warn_of_doubts,
)
from objconnect.ingestion.picture import PICTURE, draw
from objconnect.ingestion.positions import MIN_PHOTOGRAPHS, local_positions, replace_positions
from objconnect.ingestion.report import REPORT, Findings, IngestReport, make_report
from objconnect.ingestion.rotated_photographs import discard_unrotated, read_rotated
from objconnect.ingestion.run_record import DATABASE, WORK, RunRecord, flight_manifest, make_scene
from objconnect.ingestion.split import Split, choose_queries
from objconnect.scene.bundle.manifest import write_json
from objconnect.scene.colmap.database import MatchingJob, match_photographs
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.colmap.structure_from_motion import Mapper, map_photographs
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.imports.poses import CoordinateFrame
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
    """The inputs of a run.

    Attributes:
        photographs: the photographs with their cameras, the input of structure from motion.
        origin: geodetic coordinates of the world's origin.
        fixes: measured positions (3,) by name, world metres.
        queries: names of the queries.
        imported: poses of another program; None for structure from motion.
        control: ground control points. Their marks have the scale of the photographs in the scene,
            but are not rotated with them.
    """

    folder: Path
    flight: Flight
    photographs: Sequence[Photograph]
    origin: Geodetic
    fixes: Mapping[str, NDArray[np.float64]]
    queries: set[str]
    record: RunRecord
    imported: ImportedPoses | None
    control: Sequence[ControlPoint]


# More than six parameters: they are the options of the command ``ingest``.
def ingest(
    photographs: Path,
    out: Path,
    *,
    gps: Path | None = None,
    poses: Path | None = None,
    poses_frame: CoordinateFrame | None = None,
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
    """Make a scene from a folder of geotagged JPEGs, or continue an interrupted run.

    Poses come from structure from motion of all photographs, georegistered by GPS, or from a file
    of another program. The map is then triangulated from the map photographs alone.

    Args:
        photographs: folder of the photographs, with sub-folders.
        out: new folder, or one left by a run of the same photographs and options.
        gps: table of positions that replace those in EXIF, see ``replace_positions``.
        poses: poses and cameras of another program, see ``scene.imports``; photographs without a
            pose are left out.
        poses_frame: frame of ``poses``, if the file does not state it.
        gcp: list of ground control points, see ``control_points``. With ``poses``, which are not
            adjusted, all points are check points.
        checks: names of the check points, which do not take part in the adjustment.
        add: finished scene to which the photographs are added, see ``add_photographs``. It is not
            changed; ``out`` becomes a new scene of its photographs and the added ones.
        camera: calibration of all photographs; None takes it from ``poses`` or EXIF.
        size: longest side of the photographs in the scene, pixels; larger ones are reduced.
        mapper: "incremental" or "global" structure from motion.
        split: queries are every ``every``-th "photo" or flight "line", or "none".
        every: see ``split``.
        options: which photographs are matched, and standard deviations of GPS and ground control.

    Raises:
        InputError: fewer than three photographs can be read, have positions or overlap; the files
            of ``gps``, ``poses`` or ``gcp`` cannot be used; arguments contradict each other;
            ``out`` lies in ``photographs``, holds other files, cannot be written or is being
            written by another run; or for the reasons of ``add_photographs``.
    """
    if photographs.resolve() in (out.resolve(), *out.resolve().parents):
        raise InputError(f"{out} lies in the folder of photographs: choose a folder outside it")
    if add is not None:
        other = (poses, poses_frame, gcp)
        if any(each is not None for each in other) or checks or mapper != "incremental":
            raise InputError(
                "--add registers photographs in the map of the scene: leave out --poses, "
                "--poses-frame, --gcp, --gcp-check and --mapper"
            )
        settings = RunRecord(size=size, mapper=mapper, split=split, every=every, options=options)
        return add_photographs(photographs, add, out, settings, gps, camera)
    if poses is None and poses_frame is not None:
        raise InputError("--poses-frame needs a file of poses: give --poses")
    flight = read_flight(photographs)
    if gps is not None:
        flight = replace_positions(flight, gps)
    warn_of_doubts(flight, with_lenses=camera is None and poses is None)
    imported = None
    if poses is not None:
        flight, imported = read_imported(poses, flight, size, camera, poses_frame)
    _require_enough(flight, photographs)
    if checks and gcp is None:
        raise InputError("--gcp-check names points of a list: give --gcp")
    control = [] if gcp is None else read_control_points(gcp, flight, size, checks)
    record = RunRecord(
        size=size,
        mapper=mapper,
        split=split,
        every=every,
        camera=None if camera is None else str(camera),
        gps=None if gps is None else sha256_of(gps),
        poses=None if imported is None else imported.sha256,
        gcp=None if gcp is None else sha256_of(gcp),
        checks=tuple(sorted(set(checks))),
        photographs={image.file: image.sha256 for image in flight.images},
        options=options,
    )
    source = _gather_source(photographs, flight, camera, imported, control, record)
    with write_lock(out):
        return _ingest(out, source)


def _gather_source(
    folder: Path,
    flight: Flight,
    camera: Camera | None,
    imported: ImportedPoses | None,
    control: Sequence[ControlPoint],
    record: RunRecord,
) -> _Source:
    """Gather the inputs of a run; the pixels of the photographs are not read yet."""
    origin, fixes = local_positions(flight.images, None if imported is None else imported.origin)
    names = [image.name for image in flight.images]
    positions = fixes if imported is None or imported.origin is None else imported.centres
    queries = choose_queries(names, positions, record.split, record.every)
    if imported is None:
        photographs = make_photographs(flight.images, record.size, camera)
    else:
        photographs = imported.photographs()
        control = [replace(point, check=True) for point in control]
    return _Source(folder, flight, photographs, origin, fixes, queries, record, imported, control)


def _ingest(out: Path, source: _Source) -> IngestReport:
    return make_scene(
        out,
        source.record,
        lambda: _build(out, source),
        list_own_files(source.flight.images, SESSION),
        flight_manifest(source.record, source.origin, SESSION),
    )


def _build(out: Path, source: _Source) -> IngestReport:
    """Write everything of the scene but its manifest."""
    photographs, fixes, queries = source.photographs, source.fixes, source.queries
    options = source.record.options
    rotated: set[str] = set()
    if source.imported is not None:
        flight, adjusted = _use_imported_poses(out, source, source.imported)
    else:
        flight, model_path, rotated = _reconstruct(out, source)
        times = {i.name: i.exif.time.timestamp() for i in flight.images if i.exif.time}
        adjusted = adjust(model_path, photographs, fixes, times, out / WORK)
    points = [_rotate_marks(point, rotated, photographs) for point in source.control]
    adjusted, residuals = fit_to_control(
        adjusted, points, source.origin, photographs, out / WORK, options
    )
    model, images = adjusted.model, flight.images
    frames = out / "sessions" / SESSION / FRAMES
    wrong_attitudes = write_measurements(frames, adjusted, images, fixes, queries)
    sparse_map = write_map(out, model, queries, out / WORK / DATABASE)
    write_lists(out, model, images, queries)
    rotated_files = [image.file for image in images if image.name in rotated]
    gps = GpsFixes(fixes, {} if source.record.gps is not None else read_sigmas(images))
    georeference = estimate_georeference(model, adjusted.georegistration, gps, residuals, options)
    findings = Findings(wrong_attitudes, rotated_files, residuals, georeference)
    report = make_report(photographs, flight, adjusted, fixes, sparse_map, findings)
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
    # Remove the copies of photographs that were not registered.
    for name in {image.name for image in source.flight.images} - model.images.keys():
        (out / "sessions" / name).unlink(missing_ok=True)
    return report


def _rotate_marks(
    point: ControlPoint, rotated: set[str], photographs: Sequence[Photograph]
) -> ControlPoint:
    """Return a point with its marks rotated in the photographs that the scene rotates."""
    size = {p.name: np.array([p.camera.width, p.camera.height]) for p in photographs}
    marks = {name: size[name] - xy if name in rotated else xy for name, xy in point.marks.items()}
    return replace(point, marks=marks)


def _use_imported_poses(
    out: Path, source: _Source, imported: ImportedPoses
) -> tuple[Flight, AdjustedModel]:
    """Return the copied photographs and their model with the imported poses."""
    copied = copy_photographs(
        source.flight, source.folder, out / "sessions", source.record.size, ()
    )
    _require_enough(copied, source.folder)
    names = [image.name for image in copied.images]
    photographs = [photograph for photograph in source.photographs if photograph.name in set(names)]
    options, database = source.record.options, out / WORK / DATABASE
    _match(photographs, imported.centres, options, out)
    adjusted = triangulate_imported(imported, names, source.fixes, out / "sessions", database)
    return copied, adjusted


def _reconstruct(out: Path, source: _Source) -> tuple[Flight, Path, set[str]]:
    """Return the photographs of one model, the folder of the model, and the rotated photographs."""
    fixes, options = source.fixes, source.record.options
    rotated = read_rotated(out)
    copied = copy_photographs(
        source.flight, source.folder, out / "sessions", source.record.size, rotated
    )
    _require_enough(copied, source.folder)
    files = {image.name: image.file for image in copied.images}
    photographs = [photograph for photograph in source.photographs if photograph.name in files]
    _match(photographs, fixes, options, out)
    model_path, unregistered = _map(photographs, out, source.record.mapper)
    if not rotated:
        raw = read_model(model_path)
        rotated = find_upside_down(raw, georegister(raw, fixes), copied.images)
        if rotated:
            discard_unrotated(out, rotated, model_path.parent)
            return _reconstruct(out, source)
    flight = copied.leave_out({files[name]: reason for name, reason in unregistered.items()})
    return flight, model_path, rotated


def _require_enough(flight: Flight, folder: Path) -> None:
    """Refuse a flight with too few photographs for a scene."""
    if len(flight.images) < MIN_PHOTOGRAPHS:
        reasons = "".join(f"; {file}: {why}" for file, why in list(flight.left_out.items())[:3])
        raise InputError(
            f"{folder} has {len(flight.images)} usable photographs, a scene needs at least "
            f"{MIN_PHOTOGRAPHS}{reasons}"
        )


def _match(
    photographs: Sequence[Photograph],
    fixes: Mapping[str, NDArray[np.float64]],
    options: IngestOptions,
    out: Path,
) -> None:
    pairs = choose_pairs([photograph.name for photograph in photographs], fixes, options)
    with progress_bar("extract and match", len(photographs) + len(pairs)) as advance:
        job = MatchingJob(out / "sessions", pairs, SiftOptions())
        match_photographs(job, photographs, out / WORK / DATABASE, advance)


def _map(
    photographs: Sequence[Photograph], out: Path, mapper: Mapper
) -> tuple[Path, dict[str, str]]:
    """Return the model with the most photographs, and the reasons why others are not in it."""
    models = out / WORK / "models"
    with progress_bar("map", len(photographs)) as advance, atomic_folder(models) as folder:
        models_by_size = map_photographs(
            out / "sessions", photographs, out / WORK / DATABASE, folder, mapper, advance
        )
        members = [read_model(path).names for path in models_by_size]
    if not members or len(members[0]) < MIN_PHOTOGRAPHS:
        raise InputError(
            f"no {MIN_PHOTOGRAPHS} of the {len(photographs)} photographs could be registered "
            "together: photograph with more overlap, over ground with texture"
        )
    reasons = {photograph.name: "not registered: too few matches" for photograph in photographs}
    for names in reversed(members):  # a photograph may be in several
        reasons |= dict.fromkeys(names, f"in another model, of {len(names)} photographs")
    return models / models_by_size[0].name, {
        n: why for n, why in reasons.items() if n not in members[0]
    }
