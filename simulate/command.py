"""The command ``simulate``: render a scene frame by frame; resume interrupted runs."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.scene.bundle.covisibility import write_covisibility
from objconnect.scene.bundle.frames import LAYERS, Frames, Layer, write_frames
from objconnect.scene.bundle.manifest import Manifest, Session, read_json, write_json
from objconnect.scene.bundle.pictures import draw_pictures
from objconnect.scene.bundle.scene import COVISIBILITY, MANIFEST, Scene, finish_scene
from objconnect.scene.bundle.thermal import Thermal, write_thermal
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import geodetic_from_enu
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.runtime.cluster import worker_pool
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import TEMPORARY_PREFIX
from objconnect.scene.storage.exif import Exif, write_jpeg
from objconnect.scene.storage.locks import write_lock
from objconnect.scene.storage.resumable import ResumableFolder
from simulate.annotations import measure_covisibility, pixel_digests
from simulate.base_place import check_site, site_file, write_site
from simulate.camera.lens import cover_by_pinhole
from simulate.camera.sensor import expose
from simulate.config import SessionConfig, SimulateConfig
from simulate.flight.gimbal import velocities
from simulate.listing import describe_objects, list_splits
from simulate.look.conditions import condition
from simulate.place.change import ChangedWorld
from simulate.planner import check_plans
from simulate.render.disk import estimate_bytes, require_space
from simulate.render.job import RenderJob, frame_path
from simulate.render.pool import RenderError, render
from simulate.render.remote import render_files, render_remotely
from simulate.render.window import Window
from simulate.scene_plan import SessionPlan, plan_scene
from simulate.thermal.sensor import describe_thermal, expose_thermal

_CONFIG = f"{TEMPORARY_PREFIX}config.json"
_RENDERED = f"{TEMPORARY_PREFIX}rendered"

_Renderer = Callable[[RenderJob, Path, Callable[[int], None]], None]


def simulate(
    config: SimulateConfig,
    out: Path,
    jobs: int = 1,
    cluster: str | None = None,
    twin: Path | None = None,
) -> Scene:
    """Render a scene into ``out``, or continue an interrupted run; the scene has no map yet.

    Args:
        config: configuration of the scene.
        out: new folder, or one left by a run of the same configuration.
        jobs: number of rendering processes on this machine.
        cluster: cluster that renders instead of this machine, as ``worker_pool`` takes it.
        twin: finished scene of the same site, whose place is reused; None builds the place.

    Raises:
        InputError: ``out`` holds something else or cannot be written, the disk is too full, the
            place cannot be built, a session (flight) cannot be flown, rendering failed, the cluster
            does not exist, or it is given for a site (a real place).
    """
    check_site(config, out, cluster)
    with write_lock(out):
        return _simulate(config, out, jobs, cluster, twin)


def _simulate(
    config: SimulateConfig, out: Path, jobs: int, cluster: str | None, twin: Path | None
) -> Scene:
    unfinished = _resumable(out, config)
    finished = find_finished(out, config)
    if finished is not None:
        return finished
    check_plans(config)
    # All flights are planned first, so that an impossible flight is refused before rendering.
    plan = plan_scene(config, out, twin)
    sessions, names, plans = config.drawn_sessions(), config.session_names(), plan.sessions
    pixels_per_frame = max(c.width * c.height for c in map(config.photo_camera, config.sessions))
    left = _count_left(out, names, plans)
    require_space(out, estimate_bytes(left, pixels_per_frame, thermal=config.thermal))
    unfinished.begin()
    if plan.report is not None:
        write_site(out, plan.place, plan.report)
    with _renderer(jobs, cluster) as renderer:
        for name, session, session_plan in zip(names, sessions, plans, strict=True):
            _make_session(out, name, session, config, session_plan, renderer)
    write_json(out / "objects.json", describe_objects(plan.place, plan.objects))
    write_json(out / "splits.json", list_splits(out, config))
    scene = Scene(out, _manifest(config, plan.worlds))
    write_covisibility(out / COVISIBILITY, measure_covisibility(scene))
    draw_pictures(scene)
    pixels = {"pixels_sha256": pixel_digests(scene)}
    scene = finish_scene(out, scene.manifest.model_copy(update=pixels))
    unfinished.end()
    return scene


@contextmanager
def _renderer(jobs: int, cluster: str | None) -> Iterator[_Renderer]:
    """Yield the function that renders missing frames, on this machine or on a cluster."""
    if cluster is None:
        yield lambda job, folder, on_frame: render(job, folder, jobs, on_frame)
        return
    with worker_pool(cluster, render_files) as workers:
        yield partial(render_remotely, workers)


def _count_left(
    out: Path, names: Sequence[str], plans: Sequence[SessionPlan]
) -> dict[str, tuple[int, int]]:
    """Return the numbers of frames to render and to pack, by unfinished session."""
    left = {}
    for name, plan in zip(names, plans, strict=True):
        folder, frames = out / "sessions" / name, len(plan.poses)
        if not (folder / "frames.h5").is_file():
            done = sum(frame_path(folder / _RENDERED, k).exists() for k in range(frames))
            left[name] = (frames - done, frames)
    return left


def _resumable(out: Path, config: SimulateConfig) -> ResumableFolder:
    """Return the folder of a scene, which stores the configuration while it is unfinished."""

    def difference(record: Path) -> str | None:
        recorded = read_json(record, SimulateConfig, "configuration of the unfinished scene")
        return None if recorded == config else "configuration"

    return ResumableFolder(out, out / _CONFIG, config.model_dump_json(), difference)


def find_finished(out: Path, config: SimulateConfig) -> Scene | None:
    """Return the finished scene of a configuration; None if it is not finished.

    Raises:
        InputError: ``out`` holds anything but this scene or a part of it.
    """
    unfinished = _resumable(out, config)
    if (out / MANIFEST).is_file():
        scene = Scene.open(out)
        if scene.manifest.config != _dump(config):
            raise InputError(
                f"{out} holds a scene of another configuration: choose another folder or remove it"
            )
        unfinished.end()  # a run killed just before its end leaves its configuration
        return scene
    if not unfinished.can_resume(
        lambda difference: (
            f"{out} holds an unfinished scene of another {difference}: choose another folder "
            "or remove it"
        )
    ):
        unfinished.require_empty("scene")
    return None


def _dump(config: SimulateConfig) -> dict[str, Any]:
    # Older scenes were rendered with these values, and their manifests lack these fields.
    earlier = {"site": None, "denoising": "high", "courses": "shared", "change_share": 1.0,
               "thermal": False}  # fmt: skip
    omitted = {key for key, value in earlier.items() if getattr(config, key) == value}
    return config.model_dump(mode="json", exclude=omitted)


def _manifest(config: SimulateConfig, worlds: Sequence[ChangedWorld]) -> Manifest:
    return Manifest(
        versions={name: version(name) for name in ("objconnect", "bpy", "numpy", "pillow", "h5py")},
        preset=config.preset,
        seed=config.seed,
        config=_dump(config),
        origin=config.origin,
        sessions={
            name: Session(
                condition=s.condition,
                flight=s.flight.kind,
                role=s.role,
                change=changed.declared,
                readout_s=config.sensor.readout_s,
                thermal=_thermal(config, s),
            )
            for name, s, changed in zip(
                config.session_names(), config.sessions, worlds, strict=True
            )
        },
        sha256={},
    )


def _thermal(config: SimulateConfig, session: SessionConfig) -> Thermal | None:
    """Return the record of a session's thermal pictures; None without them."""
    if not config.thermal:
        return None
    return describe_thermal(condition(session.condition, config.origin), config.origin)


def render_job(
    config: SimulateConfig,
    session: SessionConfig,
    poses: NDArray[np.float64],
    first_new_id: int = 0,
    site_path: Path | None = None,
    windows: tuple[Window, ...] = (),
) -> RenderJob:
    """Return the render job of a session with poses (N, 4, 4) for frames 0 to N - 1.

    ``first_new_id`` is the first id of moved and added objects, and ``site_path`` the file of a
    site. ``windows`` are squares of tiles of a large place, each with the frames that need them.
    """
    pinhole, distorted_camera = cover_by_pinhole(config.photo_camera(session))
    travel = config.sensor.readout_s * velocities(poses, config.interval_s)
    return RenderJob(
        preset=config.preset,
        seed=config.seed,
        side_m=config.area,
        condition=session.condition,
        origin=config.origin,
        change=session.world_change,
        first_new_id=first_new_id,
        site_path=site_path,
        camera=pinhole,
        distorted_camera=distorted_camera,
        samples=config.spp,
        denoising=config.denoising,
        poses={k: pose.tolist() for k, pose in enumerate(poses)},
        thermal=config.thermal,
        windows=windows,
        travel={k: (x, y, z) for k, (x, y, z) in enumerate(travel.tolist()) if any((x, y, z))},
    )


def _make_session(
    out: Path,
    name: str,
    session: SessionConfig,
    config: SimulateConfig,
    plan: SessionPlan,
    renderer: _Renderer,
) -> None:
    """Render and pack a session unless it is finished; ``frames.h5`` is written last."""
    folder = out / "sessions" / name
    rendered = folder / _RENDERED
    if (folder / "frames.h5").is_file():
        shutil.rmtree(rendered, ignore_errors=True)  # a killed run may leave it
        return
    poses = plan.poses
    site = site_file(config, out)
    job = render_job(config, session, poses, plan.first_new_id, site, plan.windows)
    with progress_bar(name, len(poses)) as advance:
        done = sum(frame_path(rendered, k).exists() for k in range(len(poses)))
        advance(done)

        def on_frame(_: int) -> None:
            nonlocal done
            done += 1
            advance(done)

        try:
            renderer(job, rendered, on_frame)
        except RenderError as error:
            raise InputError(str(error)) from error
        except OSError as error:
            raise InputError(f"cannot write {folder}: {error.strerror or error}") from error
    frames = _frames(name, poses, config.photo_camera(session), session, config, plan.rng)
    sensor = config.sensor.adapt(condition(session.condition, config.origin).dimness)
    adapted = config.model_copy(update={"sensor": sensor})
    packed = _pack(folder, frames, adapted, _thermal(config, session))
    write_frames(folder / "frames.h5", frames, tuple(LAYERS), packed)
    shutil.rmtree(rendered)


def _frames(
    name: str,
    poses: NDArray[np.float64],
    camera: Camera,
    session: SessionConfig,
    config: SimulateConfig,
    rng: np.random.Generator,
) -> Frames:
    """Return the frames of a session, with priors drawn from the configured noise."""
    n, truth = len(poses), Pose.from_matrix(poses)
    attitude_error = config.attitude_sigma_deg * rng.standard_normal((n, 3))
    gps_error = np.array(config.gps_sigma_m) * rng.standard_normal((n, 3))
    memory = math.exp(-config.interval_s / config.drift_s)
    gps_error += np.array(config.gps_drift_m) * draw_drift(n, memory, rng)
    attitude_error += config.attitude_drift_deg * draw_drift(n, memory, rng)
    noise = Pose.exp(torch.from_numpy(np.hstack([np.radians(attitude_error), np.zeros((n, 3))])))
    gps_sigma = np.hypot(config.gps_sigma_m, config.gps_drift_m)
    start = condition(session.condition, config.origin).time.timestamp()
    return Frames(
        names=tuple(f"{name}/images/{k:06d}.jpg" for k in range(n)),
        cameras=(camera,) * n,
        cam_from_world=poses,
        time=start + config.interval_s * np.arange(n),
        gps_prior=truth.centre().numpy() + gps_error,
        gps_sigma=np.tile(gps_sigma, (n, 1)),
        attitude_prior=(noise @ truth).quaternion().numpy(),
        attitude_sigma_deg=np.full(
            n, math.hypot(config.attitude_sigma_deg, config.attitude_drift_deg)
        ),
    )


def draw_drift(count: int, memory: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw a stationary first-order Gauss-Markov process (count, 3) of unit variance.

    ``memory`` is the correlation between successive rows.
    """
    noise = rng.standard_normal((count, 3))
    for k in range(1, count):
        noise[k] = memory * noise[k - 1] + math.sqrt(1 - memory**2) * noise[k]
    return noise


def _pack(
    folder: Path, frames: Frames, config: SimulateConfig, thermal: Thermal | None = None
) -> Iterator[dict[Layer, NDArray[Any]]]:
    """Write every rendered frame's photograph and thermal pictures, and yield its annotations."""
    (folder / "images").mkdir(exist_ok=True)
    camera = frames.cameras[0]
    for k, name in enumerate(frames.names):
        with np.load(frame_path(folder / _RENDERED, k)) as layers:
            exif = Exif(
                position=geodetic_from_enu(frames.gps_prior[k], config.origin),
                time=datetime.fromtimestamp(float(frames.time[k]), UTC),
                focal_35mm=36 * camera.focal[0] / max(camera.width, camera.height),
            )
            # Each photograph has its own generator, so that the order of rendering does not matter.
            rng = np.random.default_rng([config.seed, *name.encode()])
            picture = expose(layers["rgb"], config.sensor, rng)
            write_jpeg(folder.parent / name, picture, exif, config.jpeg_quality)
            if thermal is not None:
                noise = np.random.default_rng([config.seed, *name.encode(), *b"thermal"])
                counts = expose_thermal(layers["thermal"], thermal, noise)
                write_thermal(folder.parent, name, counts, thermal)
            yield {layer: layers[layer] for layer in LAYERS}
