"""The command ``validate``, which checks the conventions and the accuracy of a scene."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.bundle.thermal import Thermal, check_thermal
from objconnect.scene.checks.depth_check import DepthFrames, check_depth
from objconnect.scene.checks.map_check import check_map
from objconnect.scene.checks.report import Check, Report
from objconnect.scene.errors import InputError
from objconnect.scene.storage.images import read_rgb

# Largest number of consecutive, hence overlapping, frames of a flight whose depth is checked.
_FRAMES_PER_SESSION = 24
# Largest root mean square error of the priors, in stated standard deviations.
_MAX_PRIOR_SIGMAS = 3.0
# Largest deviation of a valid pose from a rotation and the last row 0 0 0 1.
_MAX_RIGIDITY_ERROR = 1e-6


def validate(path: Path) -> Report:
    """Check every convention of a scene.

    Raises:
        InputError: the folder is not a scene, or one of its files cannot be read.
    """
    scene = Scene.open(path)
    return Report(str(path), tuple(_checks(scene)))


def _checks(scene: Scene) -> Iterator[Check]:
    yield _check_files(scene)
    sessions = {name: scene.frames(name) for name in scene.sessions}
    for name, frames in sessions.items():
        yield _check_images(scene, name, frames)
        record = scene.sessions[name].thermal
        if record is not None:
            yield _check_thermal(scene, name, frames, record)
        yield _check_rigid(name, frames)
        yield _check_priors(name, frames)
    rigid = {name: frames for name, frames in sessions.items() if _is_rigid(frames)}
    yield from _check_geometry(scene, rigid)
    if scene.map_path.is_dir():
        yield check_map(scene.sparse_map())
        yield _check_map_poses(scene, sessions)


def _check_files(scene: Scene) -> Check:
    name = "files match their digests"
    changed = scene.find_changed_files()
    if changed:
        detail = f"changed, missing or added since the scene was finished: {', '.join(changed[:5])}"
        return Check(name, False, detail)
    return Check(name, True, f"{len(scene.manifest.sha256)} files")


def _check_images(scene: Scene, session: str, frames: Frames) -> Check:
    name = f"{session}: photographs are whole"
    for image, camera in zip(frames.names, frames.cameras, strict=True):
        try:
            read_rgb(scene.images_root / image, camera)
        except InputError as error:
            return Check(name, False, str(error))
    return Check(name, True, f"{len(frames)} photographs, each of its camera's size")


def _check_thermal(scene: Scene, session: str, frames: Frames, record: Thermal) -> Check:
    name = f"{session}: thermal pictures are whole"
    for image, camera in zip(frames.names, frames.cameras, strict=True):
        try:
            check_thermal(scene.images_root, image, camera, record)
        except InputError as error:
            return Check(name, False, str(error))
    return Check(name, True, f"{len(frames)} pictures of 16 and 8 bits, each of its camera's size")


def _is_rigid(frames: Frames) -> bool:
    return _rigidity_error(frames) < _MAX_RIGIDITY_ERROR


def _rigidity_error(frames: Frames) -> float:
    """Return the largest deviation of a pose from a rotation with the last row 0 0 0 1."""
    rotation = frames.cam_from_world[:, :3, :3]
    gram = rotation @ rotation.transpose(0, 2, 1) - np.eye(3)
    last = frames.cam_from_world[:, 3] - np.array([0, 0, 0, 1])
    determinant = np.linalg.det(rotation) - 1
    return float(max(np.abs(gram).max(), np.abs(last).max(), np.abs(determinant).max()))


def _check_rigid(session: str, frames: Frames) -> Check:
    name = f"{session}: poses are rigid and look at the ground"
    rigidity_error = _rigidity_error(frames)
    if rigidity_error >= _MAX_RIGIDITY_ERROR:
        detail = (
            f"a rotation is off by {rigidity_error:.2g}: scaled, skewed, mirrored, or 4x4 "
            "transposed"
        )
        return Check(name, False, detail, {"departure": rigidity_error})
    downward = float(-frames.cam_from_world[:, 2, 2].mean())
    if downward < 0:
        detail = "cameras look at the sky: the world's Z points down, or poses are world_from_cam"
        return Check(name, False, detail, {"downward": downward})
    return Check(name, True, f"{len(frames)} poses", {"departure": rigidity_error})


def _check_priors(session: str, frames: Frames) -> Check:
    """Check that the measured positions and attitudes (priors) lie within their stated noise."""
    name = f"{session}: priors fit the poses"
    measured_rows = frames.has_gps
    if not measured_rows.any():
        return Check(name, True, "no position was measured")
    off = (frames.gps_prior - frames.poses.centre().numpy()) / np.maximum(frames.gps_sigma, 1e-3)
    gps = float(np.sqrt((off[measured_rows] ** 2).mean()))
    attitude = _attitude_sigmas(frames, frames.attitude_prior)
    figures = {"gps_sigmas": gps, "attitude_sigmas": attitude}
    if gps > _MAX_PRIOR_SIGMAS:
        detail = (
            f"positions are {gps:.1f} standard deviations off: priors and poses differ in origin, "
            "axes or order of coordinates"
        )
        return Check(name, False, detail, figures)
    if attitude > _MAX_PRIOR_SIGMAS:
        if _attitude_sigmas(frames, np.roll(frames.attitude_prior, 1, axis=1)) < attitude / 3:
            detail = "attitude quaternions are x y z w, expected w x y z"
        elif _attitude_sigmas(frames, frames.attitude_prior * [1, -1, -1, -1]) < attitude / 3:
            detail = "attitudes are inverted: world_from_cam where cam_from_world is expected"
        else:
            detail = f"attitudes are {attitude:.1f} standard deviations off"
        return Check(name, False, detail, figures)
    return Check(name, True, f"{gps:.2f} and {attitude:.2f} standard deviations off", figures)


def _attitude_sigmas(frames: Frames, wxyz: NDArray[np.float64]) -> float:
    """Return the root mean square error of the attitude per axis, in stated standard deviations.

    It is zero if no attitude was measured.
    """
    measured_rows = frames.has_attitude
    if not measured_rows.any():
        return 0.0
    import torch

    from objconnect.scene.geometry.pose import Pose

    measured = Pose.from_quaternion(
        wxyz[measured_rows], torch.zeros(measured_rows.sum(), 3, dtype=torch.float64)
    )
    true = Pose(frames.poses.rotation[torch.from_numpy(measured_rows)], measured.translation)
    _, degrees = measured.error_to(true)
    sigma = np.maximum(frames.attitude_sigma_deg[measured_rows], 1e-3)
    return float(np.sqrt((degrees.numpy() ** 2 / 3 / sigma**2).mean()))


def _check_geometry(scene: Scene, sessions: dict[str, Frames]) -> Iterator[Check]:
    """Check depth and poses within each session, then between sessions."""
    parts = []
    for name, frames in sessions.items():
        if scene.manifest.sessions[name].readout_s:
            detail = "not checked: with a rolling shutter every row has its own pose"
            yield Check(f"{name}: depth and poses agree", True, detail)
            continue
        with scene.layers(name) as layers:
            if not (layers.has("depth") and layers.has("instance")):
                continue
            chosen = range(min(len(frames), _FRAMES_PER_SESSION))
            part = DepthFrames(
                [frames.cameras[k] for k in chosen],
                frames.cam_from_world[: len(chosen)],
                [layers.read("depth", k) for k in chosen],
                [layers.read("instance", k) for k in chosen],
            )
        sizes = {(c.height, c.width) for c in part.cameras}
        if {d.shape for d in part.depth} != sizes:
            detail = f"depth is {part.depth[0].shape} pixels, cameras are {sorted(sizes)}"
            yield Check(f"{name}: depth and poses agree", False, detail)
            continue
        parts.append(part)
        yield check_depth(f"{name}: depth and poses agree", part)
    if len(parts) > 1:
        merged = DepthFrames(
            [camera for part in parts for camera in part.cameras],
            np.concatenate([part.cam_from_world for part in parts]),
            [image for part in parts for image in part.depth],
            [image for part in parts for image in part.instance],
        )
        yield check_depth("all sessions: depth and poses agree", merged)


def _check_map_poses(scene: Scene, sessions: dict[str, Frames]) -> Check:
    """Check that the map's cameras have the poses of the frames."""
    name = "map poses are the frames' poses"
    images = scene.sparse_map().images
    worst = 0.0
    for frames in sessions.values():
        for k, frame in enumerate(frames.names):
            if frame in images:
                difference = np.abs(images[frame].cam_from_world - frames.cam_from_world[k])
                worst = max(worst, float(difference.max()))
    # The poses of a map may have been adjusted by centimetres; a wrong convention gives far more.
    ok = worst < 0.5
    return Check(name, ok, f"largest difference {worst:.2g}", {"difference": worst})
