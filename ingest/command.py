"""From a folder of photographs to a scene; an interrupted run is taken up again."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from ingest.georegister import Georegistration, georegister
from ingest.neighbours import choose_pairs
from ingest.photographs import SESSION, Roll, Shot, photographs_of, read_roll
from ingest.picture import draw
from ingest.report import REPORT, IngestReport, make_report, residuals
from ingest.split import Split, queries_of
from scene.bundle import COVISIBILITY, FEATURES, MANIFEST, Scene, finish
from scene.camera import Camera
from scene.colmap import (
    Mapper,
    Photograph,
    PosedImage,
    SiftOptions,
    adjust_to_positions,
    map_photographs,
    match_photographs,
    read_map,
    triangulate_matched,
)
from scene.covisibility import Covisibility, visible_share, write_covisibility
from scene.errors import InputError
from scene.features import write_features
from scene.files import folder_written_whole, remove_partial
from scene.frames import Frames, write_frames
from scene.geodesy import Geodetic, enu_from_geodetic
from scene.images import read_rgb, write_resized
from scene.manifest import Manifest, Objects, Session, Splits, read_json, write_json
from scene.pose import Pose
from scene.progress import progress_bar
from scene.sparse_map import SparseMap

_WORK = ".ingest"
_PLAN = "plan.json"
_FEWEST = 3
# Focal length and height trade against each other over flat ground: where depths within a picture
# differ by less than this share of them, EXIF knows the focal length better than the pixels do.
_RELIEF = 0.25
# Points of each photograph that tell what it shares with the others.
_SAMPLED = 200
# Standard deviation of an altitude that is not one, metres.
_NO_ALTITUDE = 1e4
# A gimbal is off by a few degrees, its compass by more; a picture turned over by the camera is not
# what its gimbal says.
_WRONG_ATTITUDE_DEG = 30.0
_LEAST_SIGMA, _LEAST_SIGMA_DEG = 0.02, 0.1


class _Plan(BaseModel):
    """What an ingest is of; a folder left by another one is not gone on with."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    size: int
    mapper: str
    split: str
    every: int
    camera: str | None
    photographs: dict[str, str]


def ingest(
    photographs: Path,
    out: Path,
    *,
    camera: Camera | None = None,
    size: int = 1600,
    mapper: Mapper = "incremental",
    split: Split = "photo",
    every: int = 4,
) -> IngestReport:
    """Turn a folder of geotagged JPEGs into a scene, or go on where an interrupted run stopped.

    Poses come from structure from motion of all photographs together, placed by GPS; the map is
    triangulated anew from its own photographs.

    Args:
        photographs: folder, looked through with the folders in it.
        out: folder, new or left by a run of the same photographs and options.
        camera: calibration of all photographs; None takes it from EXIF.
        size: longest side of the photographs in the scene, pixels; larger ones are made smaller.
        mapper: "incremental" or "global" structure from motion.
        split: queries are every ``every``-th "photo" or flight "line", or "none".
        every: see ``split``.

    Raises:
        InputError: fewer than three photographs, or positions, or photographs that hang together;
            ``out`` holds something else or cannot be written.
    """
    if photographs.resolve() in (out.resolve(), *out.resolve().parents):
        raise InputError(f"{out} lies in the folder of photographs: choose one outside it")
    roll = read_roll(photographs)
    _require(roll, photographs)
    plan = _Plan(
        size=size,
        mapper=mapper,
        split=split,
        every=every,
        camera=None if camera is None else str(camera),
        photographs={shot.file: shot.sha256 for shot in roll.shots},
    )
    origin, fixes = _positions(roll.shots)
    queries = queries_of([shot.name for shot in roll.shots], fixes, split, every)
    taken = photographs_of(roll.shots, size, camera)
    if _finished(out, plan):
        return read_json(out / REPORT, IngestReport, "report of the ingested flight")
    write_json(out / _WORK / _PLAN, plan)
    remove_partial(out)
    try:
        roll = _place(roll, photographs, out, size)
        _require(roll, photographs)
        report = _build(out, roll, taken, fixes, queries, mapper)
    except InputError:
        # These photographs make no scene: nothing is left to go on with.
        shutil.rmtree(out, ignore_errors=True)
        raise
    finish(out, _manifest(plan, origin))
    shutil.rmtree(out / _WORK)
    return report


def _build(
    out: Path,
    roll: Roll,
    taken: Sequence[Photograph],
    fixes: Mapping[str, NDArray[np.float64]],
    queries: set[str],
    mapper: Mapper,
) -> IngestReport:
    """Everything of the scene but its manifest."""
    files = {shot.name: shot.file for shot in roll.shots}
    taken = [photograph for photograph in taken if photograph.name in files]
    _match(taken, fixes, out)
    model_path, elsewhere = _map(taken, out, mapper)
    roll = roll.without({files[name]: reason for name, reason in elsewhere.items()})
    model, placed, refined = _georegister(model_path, taken, fixes, out / _WORK)
    shots = roll.shots
    wrong_attitudes = _write_frames(out, model, shots, fixes, queries, placed)
    sparse_map = _triangulate(out, model, queries)
    _write_lists(out, model, shots, queries)
    report = make_report(
        taken,
        files,
        roll.left_out,
        model,
        fixes,
        placed,
        refined,
        sparse_map,
        wrong_attitudes,
    )
    write_json(out / REPORT, report)
    draw(
        out / "pictures" / "ingest.png",
        f"{out.resolve().name}: {report.registered} photographs, {report.points} points",
        model,
        [shot.name for shot in shots],
        queries,
        fixes,
        placed.blunders,
    )
    for name in files.keys() - model.images.keys():
        (out / "sessions" / name).unlink(missing_ok=True)
    return report


def _require(roll: Roll, folder: Path) -> None:
    """Refuse a roll too short for a scene."""
    if len(roll.shots) < _FEWEST:
        reasons = "".join(f"; {file}: {why}" for file, why in list(roll.left_out.items())[:3])
        raise InputError(
            f"{folder} has {len(roll.shots)} usable photographs, {_FEWEST} are the fewest that "
            f"make a scene{reasons}"
        )


def _finished(out: Path, plan: _Plan) -> bool:
    """Whether the folder holds this very flight already; refuse one that holds something else."""
    if (out / MANIFEST).is_file():
        if Scene.open(out).manifest.config != plan.model_dump(mode="json"):
            raise InputError(
                f"{out} holds a scene of other photographs or options: choose another folder or "
                "remove it"
            )
        shutil.rmtree(out / _WORK, ignore_errors=True)  # left by a run killed at its very end
        return True
    if (out / _WORK / _PLAN).is_file():
        if read_json(out / _WORK / _PLAN, _Plan, "plan of the unfinished scene") != plan:
            raise InputError(
                f"{out} holds an unfinished scene of other photographs or options: choose another "
                "folder or remove it"
            )
        return False
    try:
        # A run killed while it claimed the folder left nothing but its own folder.
        occupied = out.exists() and any(item.name != _WORK for item in out.iterdir())
    except OSError as error:
        raise InputError(f"cannot use {out} for a scene: {error.strerror}") from None
    if occupied:
        raise InputError(f"{out} is not empty and not a scene: choose another folder")
    return False


def _positions(shots: Sequence[Shot]) -> tuple[Geodetic, dict[str, NDArray[np.float64]]]:
    """An origin amid the photographs, and their GPS positions from there."""
    known = {s.name: s.exif.position for s in shots if s.exif.position is not None}
    if len(known) < _FEWEST:
        raise InputError(
            f"{len(known)} of {len(shots)} photographs have a GPS position in their EXIF, "
            f"{_FEWEST} are needed: a scene has metres and a place on earth"
        )
    # Of each coordinate, so that a few wrong ones do not count.
    origin = Geodetic(*np.median(np.array(list(known.values())), axis=0).tolist())
    return origin, {name: enu_from_geodetic(place, origin) for name, place in known.items()}


def _place(roll: Roll, folder: Path, out: Path, size: int) -> Roll:
    """Copy photographs into the scene; those that turn out damaged are left out."""
    damaged = {}
    with progress_bar("copy photographs", len(roll.shots)) as advance:
        for done, shot in enumerate(roll.shots, 1):
            target = out / "sessions" / shot.name
            if not target.is_file():
                try:
                    read_rgb(folder / shot.file)
                except InputError as error:
                    damaged[shot.file] = str(error)
                else:
                    write_resized(folder / shot.file, target, size)
            advance(done)
    return roll.without(damaged)


def _match(
    taken: Sequence[Photograph], fixes: Mapping[str, NDArray[np.float64]], out: Path
) -> None:
    pairs = choose_pairs([photograph.name for photograph in taken], fixes)
    with progress_bar("extract and match", len(taken) + len(pairs)) as advance:
        match_photographs(
            out / "sessions", taken, pairs, out / _WORK / "database.db", SiftOptions(), advance
        )


def _map(taken: Sequence[Photograph], out: Path, mapper: Mapper) -> tuple[Path, dict[str, str]]:
    """The model of most photographs, and why the photographs that are not in it are not."""
    models = out / _WORK / "models"
    with progress_bar("map", len(taken)) as advance, folder_written_whole(models) as folder:
        found = map_photographs(
            out / "sessions", taken, out / _WORK / "database.db", folder, mapper, advance
        )
        members = [read_map(path).names for path in found]
    if not members or len(members[0]) < _FEWEST:
        raise InputError(
            f"no {_FEWEST} of the {len(taken)} photographs hang together: they need overlap and "
            "texture"
        )
    reasons = {photograph.name: "not registered: too few matches" for photograph in taken}
    for names in reversed(members):  # a photograph may be in several
        reasons |= dict.fromkeys(names, f"in another model, of {len(names)} photographs")
    return models / found[0].name, {n: why for n, why in reasons.items() if n not in members[0]}


def _georegister(
    model_path: Path,
    taken: Sequence[Photograph],
    fixes: Mapping[str, NDArray[np.float64]],
    work: Path,
) -> tuple[SparseMap, Georegistration, set[str]]:
    """The model in the world, adjusted to pixels and GPS; the lenses whose focal length was."""
    raw = read_map(model_path)
    placed = georegister(raw, fixes)
    trusted = {n: fixes[n] for n in raw.names if n in fixes and n not in placed.blunders}
    sigma = placed.sigma.copy()
    if placed.level == "ground":
        for name in trusted:
            height = placed.apply(raw.images[name].centre[None])[0, 2]
            trusted[name] = np.array([*trusted[name][:2], height])
        sigma[2] = _NO_ALTITUDE
    tell = _relief(raw) > _RELIEF
    refined = {p.lens for p in taken if not p.calibrated and (tell or not p.focal_known)}
    with folder_written_whole(work / "adjusted") as folder:
        model = adjust_to_positions(
            model_path, taken, placed.world_from_model, trusted, sigma, refined, folder
        )
    return model, placed, refined


def _relief(model: SparseMap) -> float:
    """How much the depths within a photograph differ, as a share of them: the median photograph."""
    spread = []
    for image in model.images.values():
        xyz = model.xyz[image.point_rows[image.point_rows >= 0]]
        depth = (xyz @ image.cam_from_world[:3, :3].T + image.cam_from_world[:3, 3])[:, 2]
        if len(depth):
            near, middle, far = np.percentile(depth, [5, 50, 95])
            spread.append((far - near) / middle)
    return float(np.median(spread))


def _write_frames(
    out: Path,
    model: SparseMap,
    shots: Sequence[Shot],
    fixes: Mapping[str, NDArray[np.float64]],
    queries: set[str],
    placed: Georegistration,
) -> dict[str, float]:
    """Poses of the model, and what was measured with it; sigmas are those of the map's frames.

    Returns by file the degrees that attitudes are off which were not used.
    """
    names = tuple(shot.name for shot in shots)
    poses = np.stack([model.images[name].cam_from_world for name in names])
    measured = [name for name in names if name in fixes and name not in placed.blunders]
    mapped = [name for name in measured if name not in queries] or measured
    off = residuals(model, fixes, mapped)
    sigma = np.maximum(np.sqrt((off**2).mean(0)), _LEAST_SIGMA)
    nothing = np.full(3, np.nan)
    attitude, attitude_sigma, wrong = _attitudes(shots, poses, queries)
    times = [shot.exif.time.timestamp() if shot.exif.time else np.nan for shot in shots]
    frames = Frames(
        names=names,
        cameras=tuple(model.images[name].camera for name in names),
        cam_from_world=poses,
        time=np.array(times),
        gps_prior=np.array([fixes[n] if n in measured else nothing for n in names]),
        gps_sigma=np.array([sigma if n in measured else nothing for n in names]),
        attitude_prior=attitude,
        attitude_sigma_deg=attitude_sigma,
    )
    write_frames(out / "sessions" / SESSION / "frames.h5", frames, (), iter([{}] * len(names)))
    return wrong


def _attitudes(
    shots: Sequence[Shot], poses: NDArray[np.float64], queries: set[str]
) -> tuple[NDArray[np.float64], NDArray[np.float64], dict[str, float]]:
    """Quaternions (N, 4) of the gimbal and their sigma (N,), degrees per axis, NaN without one; and
    by file how far (degrees) those are off that contradict their photograph."""
    quaternions = np.full((len(shots), 4), np.nan)
    errors = np.full(len(shots), np.nan)
    for k, shot in enumerate(shots):
        if shot.exif.gimbal is not None:
            pose = gimbal_pose(*shot.exif.gimbal)
            quaternions[k] = pose.quaternion().numpy()
            there = Pose(Pose.from_matrix(poses[k]).rotation, pose.translation)
            errors[k] = float(pose.error_to(there)[1])
    wrong = errors > _WRONG_ATTITUDE_DEG
    blunders = {shots[k].file: float(errors[k]) for k in np.flatnonzero(wrong)}
    quaternions[wrong] = errors[wrong] = np.nan
    known = np.isfinite(errors)
    mapped = known & np.array([shot.name not in queries for shot in shots])
    if not mapped.any():
        mapped = known
    sigma = np.sqrt((errors[mapped] ** 2).mean() / 3) if known.any() else np.nan
    return quaternions, np.where(known, np.maximum(sigma, _LEAST_SIGMA_DEG), np.nan), blunders


def gimbal_pose(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Pose:
    """The rotation ``cam_from_world`` of a gimbal, at the origin.

    Args:
        yaw_deg: of the optical axis, clockwise from north.
        pitch_deg: of it above the horizon.
        roll_deg: about it, clockwise as the camera looks.
    """
    yaw, pitch, roll = np.radians([yaw_deg, pitch_deg, roll_deg])
    forward = [np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)]
    right = np.array([np.cos(yaw), -np.sin(yaw), 0.0])
    down = np.cross(forward, right)
    rolled = [
        np.cos(roll) * right + np.sin(roll) * down,
        np.cos(roll) * down - np.sin(roll) * right,
        forward,
    ]
    return Pose(torch.tensor(np.array(rolled)), torch.zeros(3, dtype=torch.float64))


def _triangulate(out: Path, model: SparseMap, queries: set[str]) -> SparseMap:
    images = [
        PosedImage(name, model.images[name].camera, model.images[name].cam_from_world)
        for name in model.names
        if name not in queries
    ]
    with folder_written_whole(out / "map") as folder:
        sparse_map, features = triangulate_matched(
            out / "sessions", images, out / _WORK / "database.db", folder
        )
        write_features(folder / FEATURES, features)
    return sparse_map


def _write_lists(out: Path, model: SparseMap, shots: Sequence[Shot], queries: set[str]) -> None:
    names = tuple(shot.name for shot in shots)
    asked = tuple(name for name in names if name in queries)
    splits = Splits(
        map=tuple(name for name in names if name not in queries),
        queries={SESSION: asked} if asked else {},
    )
    write_json(out / "splits.json", splits)
    write_json(out / "objects.json", Objects(classes={}, objects=()))
    write_covisibility(out / COVISIBILITY, _covisibility(model, names))


def _covisibility(model: SparseMap, names: tuple[str, ...]) -> Covisibility:
    """From points in view instead of depth: what hides behind something counts as seen."""
    points = np.full((len(names), _SAMPLED, 3), np.nan)
    for k, name in enumerate(names):
        rows = model.images[name].point_rows
        seen = model.xyz[rows[rows >= 0]]
        chosen = seen[np.linspace(0, len(seen) - 1, min(_SAMPLED, len(seen))).astype(int)]
        points[k, : len(chosen)] = chosen
    images = [model.images[name] for name in names]
    poses = np.stack([image.cam_from_world for image in images])
    return Covisibility(names, visible_share([image.camera for image in images], poses, points))


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
