"""Export to nerfstudio: ``transforms.json``.

Camera axes are OpenGL's. The photographs stay in the scene; their paths are relative to the file.
Depth is planar z in millimetres, which nerfstudio's default scale converts to metres; 0 means no
surface.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.exports.lens import coefficients
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.runtime.progress import progress_bar

# nerfstudio multiplies depth by its option depth_unit_scale_factor, by default 0.001.
_UNITS_PER_METRE = 1000


def write(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    """Write ``transforms.json``; see ``formats.Writer``.

    Raises:
        InputError: the sessions mix perspective and fisheye cameras, or a lens has a rational
            distortion (k4, k5 or k6).
    """
    _write_document(scene, sessions, folder, final, {})


def write_with_depth(
    scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path
) -> None:
    """Write ``transforms.json``, and a depth map of each photograph; see ``formats.Writer``.

    Depth maps are NumPy files, because a 16-bit picture holds at most 65 m, less than many flights
    need.

    Raises:
        InputError: a session has no depth, the sessions mix perspective and fisheye cameras, or a
            lens has a rational distortion (k4, k5 or k6).
    """
    depths: dict[str, str] = {}
    count = sum(len(frames) for frames in sessions.values())
    with progress_bar("write depth", count) as advance:
        for session, frames in sessions.items():
            with scene.layers(session) as layers:
                for k, name in enumerate(frames.names):
                    depths[name] = (Path("depth") / name).with_suffix(".npy").as_posix()
                    target = folder / depths[name]
                    target.parent.mkdir(parents=True, exist_ok=True)
                    np.save(target, layers.read("depth", k) * np.float32(_UNITS_PER_METRE))
                    advance(len(depths))
    _write_document(scene, sessions, folder, final, depths)


def _write_document(
    scene: Scene,
    sessions: Mapping[str, Frames],
    folder: Path,
    final: Path,
    depths: Mapping[str, str],
) -> None:
    """Write ``transforms.json`` with the path of each photograph's depth map, by name."""
    cameras = list(dict.fromkeys(c for frames in sessions.values() for c in frames.cameras))
    if len({camera.is_fisheye for camera in cameras}) > 1:
        raise InputError(
            "transforms.json has one camera model, and these sessions use perspective and fisheye "
            "cameras: export them separately with --session"
        )
    shared = _intrinsics(cameras[0]) if len(cameras) == 1 else {}
    root = os.path.relpath(scene.images_root.resolve(), final.resolve())
    frames_json = []
    for frames in sessions.values():
        world_from_cam = frames.poses.inverse().matrix().numpy()
        # OpenGL's camera looks along -z with y up.
        transforms = world_from_cam @ np.diag([1.0, -1.0, -1.0, 1.0])
        for name, camera, transform in zip(frames.names, frames.cameras, transforms, strict=True):
            intrinsics = {} if shared else _intrinsics(camera)
            depth = {"depth_file_path": depths[name]} if name in depths else {}
            frames_json.append(
                {
                    "file_path": (Path(root) / name).as_posix(),
                    **depth,
                    **intrinsics,
                    "transform_matrix": transform.tolist(),
                }
            )
    model = "OPENCV_FISHEYE" if cameras[0].is_fisheye else "OPENCV"
    document = {"camera_model": model, **shared, "frames": frames_json}
    (folder / "transforms.json").write_text(json.dumps(document, indent=1) + "\n", "utf-8")


def _intrinsics(camera: Camera) -> dict[str, float]:
    """Return intrinsics under nerfstudio's names; its pixel coordinates are COLMAP's.

    Raises:
        InputError: the lens has a rational distortion (k4, k5 or k6).
    """
    (fl_x, fl_y), (cx, cy) = camera.focal, camera.principal
    names = ("k1", "k2", "k3", "k4") if camera.is_fisheye else ("k1", "k2", "p1", "p2")
    more = ("k3",) if camera.model == "FULL_OPENCV" else ()
    return {
        "w": camera.width,
        "h": camera.height,
        "fl_x": fl_x,
        "fl_y": fl_y,
        "cx": cx,
        "cy": cy,
        **coefficients(camera, (*names, *more), "transforms.json of nerfstudio"),
    }
