"""Make a new scene (a folder with photographs, poses and a map) from a scene and more photographs.

The finished scene is not changed, so that results on it stay valid. The new scene has the same
frames, bit by bit, and the new photographs as a session (flight) of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.adjustment import AdjustedModel
from objconnect.ingestion.attitude import find_upside_down
from objconnect.ingestion.imported_poses import compare_with_fixes
from objconnect.ingestion.lenses import apply_known_lenses
from objconnect.ingestion.neighbours import choose_pairs, choose_similar
from objconnect.ingestion.outputs import (
    COVISIBILITY_POINTS,
    FRAMES,
    list_own_files,
    sample_evenly,
    sample_points,
    write_map,
    write_measurements,
)
from objconnect.ingestion.photographs import (
    SESSION,
    Flight,
    FlightImage,
    copy_photographs,
    make_photographs,
    read_flight,
    warn_of_doubts,
)
from objconnect.ingestion.picture import PICTURE, draw
from objconnect.ingestion.positions import local_positions, replace_positions
from objconnect.ingestion.report import REPORT, Findings, IngestReport, make_report
from objconnect.ingestion.rotated_photographs import discard_unrotated, read_rotated
from objconnect.ingestion.run_record import (
    DATABASE,
    WORK,
    RunRecord,
    flight_manifest,
    make_scene,
    read_run_record,
)
from objconnect.ingestion.split import choose_queries
from objconnect.scene.bundle.covisibility import Covisibility, visible_share, write_covisibility
from objconnect.scene.bundle.manifest import Manifest, Splits, write_json
from objconnect.scene.bundle.scene import COVISIBILITY, MANIFEST, Scene
from objconnect.scene.colmap.database import MatchingJob
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.colmap.registration import KnownMap, match_new, register_photographs
from objconnect.scene.colmap.sift import read_features
from objconnect.scene.colmap.structure_from_motion import RefinedLenses
from objconnect.scene.errors import InputError
from objconnect.scene.exports.matches import iterate_matches, read_map_features
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.photographs import Photograph, PosedImage
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import atomic_folder, atomic_write, link_or_copy
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.locks import write_lock

Array = NDArray[np.float64]

# Poses of map and frames are equal up to rounding if their entries differ by less than this,
# absolutely or relatively.
_ROUNDING: Final = 1e-9


@dataclass(frozen=True)
class _Source:
    """The inputs of a run: a finished scene, new photographs, and a record of inputs and options.

    Attributes:
        base: the scene that photographs are added to.
        photographs: the photographs with cameras, as structure from motion reads them.
        fixes: measured positions (3,) by name, metres in the scene's world.
        queries: names of the queries.
    """

    base: Scene
    session: str
    folder: Path
    flight: Flight
    photographs: Sequence[Photograph]
    fixes: Mapping[str, Array]
    queries: set[str]
    record: RunRecord


def add_photographs(
    photographs: Path,
    scene: Path,
    out: Path,
    settings: RunRecord,
    gps: Path | None = None,
    camera: Camera | None = None,
) -> IngestReport:
    """Add photographs to a finished scene, or continue an interrupted run.

    The frames of the scene keep their poses, cameras and files. New photographs are registered in
    its map by feature matches. Positions are optional: they choose the pairs to match, and become
    priors. Without ``camera``, a photograph from a lens of the scene takes the scene's camera of
    that lens.

    Args:
        photographs: folder of the new photographs.
        scene: finished scene with a map; it does not change.
        out: new folder, or one left by a run of the same scene, photographs and options.
        settings: size, split and options of the run.
        gps: table of positions that replace those in EXIF.
        camera: calibration of all new photographs; None takes the scene's cameras of known lenses,
            and EXIF for the others.

    Raises:
        InputError: none of the photographs is new, readable and matched to the map; the scene is
            unfinished, has no map or was changed; ``out`` is in the scene, holds other files,
            cannot be written or is being written by another run.
    """
    if scene.resolve() in (out.resolve(), *out.resolve().parents):
        raise InputError(f"{out} lies in the scene {scene}: choose a folder outside it")
    base = Scene.open(scene)
    base.check_readable()
    base.covisibility.select([*base.splits.map, *sum(base.splits.queries.values(), ())])
    read_map_features(base)
    session = _name_session(base)
    known = _known_photographs(base)
    flight = _drop_known(read_flight(photographs, session), known, scene)
    if gps is not None:
        flight = replace_positions(flight, gps)
    warn_of_doubts(flight, with_lenses=camera is None)
    record = settings.model_copy(
        update={
            "camera": None if camera is None else str(camera),
            "gps": None if gps is None else sha256_of(gps),
            "base": sha256_of(scene / MANIFEST),
            "known": known,
            "photographs": {image.file: image.sha256 for image in flight.images},
        }
    )
    names = [image.name for image in flight.images]
    _, fixes = local_positions(flight.images, base.manifest.origin)
    queries = choose_queries(names, fixes, record.split, record.every)
    new_photographs = make_photographs(flight.images, record.size, camera)
    if camera is None:
        new_photographs = apply_known_lenses(base, flight.images, new_photographs)
    source = _Source(base, session, photographs, flight, new_photographs, fixes, queries, record)
    with write_lock(out):
        return make_scene(
            out,
            record,
            lambda: _build(out, source),
            list_own_files(flight.images, session) | set(base.manifest.sha256),
            _manifest(source),
        )


def _name_session(base: Scene) -> str:
    number = 1
    while (name := SESSION if number == 1 else f"{SESSION}-{number}") in base.sessions:
        number += 1
    return name


def _known_photographs(base: Scene) -> dict[str, str]:
    """Return files by digest: the photographs in a scene, and the originals they were made of."""
    files = {digest: name for name, digest in base.manifest.sha256.items() if "/images/" in name}
    record = read_run_record(base.manifest)
    if record is not None:
        files |= record.known | {digest: file for file, digest in record.photographs.items()}
    return files


def _drop_known(flight: Flight, known: Mapping[str, str], scene: Path) -> Flight:
    """Return the flight without photographs that are in the scene."""
    duplicates = {
        image.file: f"already in the scene as {known[image.sha256]}"
        for image in flight.images
        if image.sha256 in known
    }
    new = flight.leave_out(duplicates)
    if not new.images:
        file, why = next(iter(new.left_out.items()))
        reason = f"{file} is {why}" if file in duplicates else why
        raise InputError(
            f"none of the {len(new.left_out)} photographs can be added to {scene}: {reason}"
        )
    return new


def _build(out: Path, source: _Source) -> IngestReport:
    """Write everything of the scene but its manifest."""
    base, queries = source.base, source.queries
    _copy_sessions(base, out)
    known = _read_known_map(base)
    flight, model, rotated = _register(out, source, known)
    images, fixes = flight.images, source.fixes
    georegistration = replace(compare_with_fixes(_select_images(model, images), fixes), level="map")
    adjusted = AdjustedModel(model, georegistration, RefinedLenses(()), 0.0, {}, out / WORK)
    frames = out / "sessions" / source.session / FRAMES
    wrong_attitudes = write_measurements(frames, adjusted, images, fixes, queries)
    sparse_map = write_map(out, model, queries, out / WORK / DATABASE, known)
    splits = _write_splits_and_covisibility(out, source, model, [image.name for image in images])
    rotated_files = [image.file for image in images if image.name in rotated]
    report = make_report(
        source.photographs,
        flight,
        adjusted,
        fixes,
        sparse_map,
        Findings(wrong_attitudes, rotated_files, georeference=base.manifest.effective_georeference),
    ).model_copy(
        update={
            "registered": len(images),
            "queries": sum(map(len, splits.queries.values())),
            "kept": sum(len(base.frames(session)) for session in base.sessions),
        }
    )
    write_json(out / REPORT, report)
    title = f"{for_terminal(out.resolve().name)}: {len(images)} photographs added"
    draw(out / PICTURE, title, adjusted, [image.name for image in images], queries, fixes)
    # Remove the copies of photographs that were not registered.
    for name in {image.name for image in source.flight.images} - model.images.keys():
        (out / "sessions" / name).unlink(missing_ok=True)
    return report


def _copy_sessions(base: Scene, out: Path) -> None:
    """Link or copy the sessions and objects of a scene, each file whole or not at all."""
    wanted = {n: d for n, d in base.manifest.sha256.items() if n.startswith("sessions/")}
    wanted["objects.json"] = base.manifest.sha256.get("objects.json", "")
    with progress_bar("copy the scene", len(wanted)) as advance:
        for done, (name, digest) in enumerate(wanted.items(), 1):
            if not (base.path / name).is_file() or sha256_of(base.path / name) != digest:
                raise InputError(
                    f"{base.path / name} was changed or removed since the scene was finished: run "
                    f"'objconnect validate {base.path}'"
                )
            if not (out / name).is_file():
                with atomic_write(out / name) as partial:
                    partial.unlink()
                    link_or_copy(base.path / name, partial)
            advance(done)


def _read_known_map(base: Scene) -> KnownMap:
    """Return the map of a scene, with the exact poses of frames whose map poses were rounded."""
    sparse_map, features = read_map_features(base)
    exact: dict[str, Array] = {}
    for session in base.sessions:
        frames = base.frames(session)
        exact |= dict(zip(frames.names, frames.cam_from_world, strict=True))
    images = []
    for name in sparse_map.names:
        image = sparse_map.images[name]
        pose = exact.get(name, image.cam_from_world)
        same = np.allclose(pose, image.cam_from_world, rtol=_ROUNDING, atol=_ROUNDING)
        images.append(PosedImage(name, image.camera, pose if same else image.cam_from_world))
    return KnownMap(images, sparse_map, features, list(iterate_matches(base, sparse_map)))


def _register(out: Path, source: _Source, known: KnownMap) -> tuple[Flight, SparseMap, set[str]]:
    """Return the registered photographs, the map with them, and the rotated photographs."""
    root, models = out / "sessions", out / WORK / "models"
    base = source.base
    rotated = read_rotated(out)
    copied = copy_photographs(source.flight, source.folder, root, source.record.size, rotated)
    names = {image.name for image in copied.images}
    photographs = [photograph for photograph in source.photographs if photograph.name in names]
    _match(out, source, known, photographs)
    with progress_bar("register", len(photographs)) as advance, atomic_folder(models) as folder:
        model = register_photographs(
            root, known, photographs, out / WORK / DATABASE, folder, advance
        )
    registered = model.images.keys()
    lost = [image.file for image in copied.images if image.name not in registered]
    flight = copied.leave_out(dict.fromkeys(lost, "not registered: too few matches"))
    if not flight.images:
        raise InputError(
            f"none of the {len(source.flight.images)} new photographs could be registered in "
            f"{source.base.path}: photograph the ground that its map shows, in similar light"
        )
    if not rotated:
        new = _select_images(model, flight.images)
        rotated = find_upside_down(
            new,
            compare_with_fixes(new, source.fixes),
            flight.images,
            upright_count=sum(int(base.frames(s).has_attitude.sum()) for s in base.sessions),
        )
        if rotated:
            discard_unrotated(out, rotated, models)
            return _register(out, source, known)
    poses = {image.name: image.cam_from_world for image in known.images}
    images = {
        name: replace(image, cam_from_world=poses.get(name, image.cam_from_world))
        for name, image in model.images.items()
    }
    return flight, replace(model, images=images), rotated


def _match(out: Path, source: _Source, known: KnownMap, photographs: Sequence[Photograph]) -> None:
    """Match the new photographs with each other, and with map photographs near or similar."""
    options, root, database = source.record.options, out / "sessions", out / WORK / DATABASE
    new, old = [p.name for p in photographs], [image.name for image in known.images]
    centres = {n: known.sparse_map.images[n].centre for n in old}
    job = MatchingJob(root, (), SiftOptions())
    with progress_bar("extract", len(old) + len(new)) as advance:
        match_new(known, photographs, job, database, advance)
    with_gps = [name for name in new if name in source.fixes]
    neighbours = choose_pairs([*old, *with_gps], {**centres, **source.fixes}, options)
    pairs = {pair for pair in neighbours if pair[1] in source.fixes}
    pairs |= set(choose_pairs(new, source.fixes, options))
    if len(with_gps) < len(new):
        without_gps = [name for name in new if name not in source.fixes]
        features = read_features(database, root)
        pairs |= set(choose_similar(without_gps, old, features, options))
    job = replace(job, pairs=sorted(pairs))
    with progress_bar("match", len(old) + len(new) + len(pairs)) as advance:
        match_new(known, photographs, job, database, advance)


def _select_images(model: SparseMap, images: Sequence[FlightImage]) -> SparseMap:
    """Return a model with only the photographs ``images``."""
    return replace(model, images={image.name: model.images[image.name] for image in images})


def _write_splits_and_covisibility(
    out: Path, source: _Source, model: SparseMap, names: Sequence[str]
) -> Splits:
    """Write and return the splits of the scene with the new photographs; write covisibility."""
    base = source.base
    new_queries = tuple(name for name in names if name in source.queries)
    splits = Splits(
        map=(*base.splits.map, *(name for name in names if name not in source.queries)),
        queries={**base.splits.queries, **({source.session: new_queries} if new_queries else {})},
    )
    write_json(out / "splits.json", splits)
    old = base.covisibility
    cameras: dict[str, Camera] = {}
    poses: dict[str, Array] = {}
    for session in base.sessions:
        frames = base.frames(session)
        cameras |= dict(zip(frames.names, frames.cameras, strict=True))
        poses |= dict(zip(frames.names, frames.cam_from_world, strict=True))
    cameras |= {name: model.images[name].camera for name in names}
    poses |= {name: model.images[name].cam_from_world for name in names}
    all_names = (*old.names, *names)
    points = [
        sample_points(model, name, COVISIBILITY_POINTS)
        if name in model.images
        else sample_evenly(
            _select_in_view(model.xyz, cameras[name], poses[name]), COVISIBILITY_POINTS
        )
        for name in all_names
    ]
    overlap = visible_share(
        [cameras[name] for name in all_names],
        np.stack([poses[name] for name in all_names]),
        np.stack(points),
    )
    overlap[: len(old.names), : len(old.names)] = old.overlap
    write_covisibility(out / COVISIBILITY, Covisibility(all_names, overlap))
    return splits


def _select_in_view(xyz: Array, camera: Camera, cam_from_world: Array) -> Array:
    """Return the points (N, 3) that project into a picture; occlusion is not tested."""
    import torch

    projected = camera.project(Pose.from_matrix(cam_from_world).transform(torch.from_numpy(xyz)))
    xy, size = projected.xy.numpy(), (camera.width, camera.height)
    inside = projected.valid.numpy() & (xy >= 0).all(1) & (xy < size).all(1)
    return np.asarray(xyz[inside])


def _manifest(source: _Source) -> Manifest:
    base = source.base.manifest
    new = flight_manifest(source.record, base.origin, source.session)
    return new.model_copy(
        update={
            "preset": base.preset,
            "seed": base.seed,
            "sessions": {**base.sessions, **new.sessions},
            "pixels_sha256": base.pixels_sha256,
        }
    )
