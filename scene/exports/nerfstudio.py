"""Export to nerfstudio: ``transforms.json``.

Camera axes are OpenGL's, and the paths of the photographs, which stay in the scene, are relative to
the file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from scene.bundle.frames import Frames
from scene.bundle.scene import Scene
from scene.errors import InputError
from scene.geometry.camera import Camera


def write(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    """Write ``transforms.json``; see ``formats.Writer``.

    Raises:
        InputError: the sessions mix perspective and fisheye cameras.
    """
    cameras = list(dict.fromkeys(c for frames in sessions.values() for c in frames.cameras))
    if len({camera.is_fisheye for camera in cameras}) > 1:
        raise InputError(
            "transforms.json has one camera model, and these sessions fly perspective and fisheye "
            "cameras: export them apart with --session"
        )
    shared = _intrinsics(cameras[0]) if len(cameras) == 1 else {}
    root = os.path.relpath(scene.images_root.resolve(), final.resolve())
    frames_json = []
    for frames in sessions.values():
        world_from_cam = frames.poses.inverse().matrix().numpy()
        # OpenGL's camera looks along -z with y up.
        transforms = world_from_cam @ np.diag([1.0, -1.0, -1.0, 1.0])
        for name, camera, transform in zip(frames.names, frames.cameras, transforms, strict=True):
            own = {} if shared else _intrinsics(camera)
            file_path = (Path(root) / name).as_posix()
            frames_json.append(
                {"file_path": file_path, **own, "transform_matrix": transform.tolist()}
            )
    model = "OPENCV_FISHEYE" if cameras[0].is_fisheye else "OPENCV"
    document = {"camera_model": model, **shared, "frames": frames_json}
    (folder / "transforms.json").write_text(json.dumps(document, indent=1) + "\n", "utf-8")


def _intrinsics(camera: Camera) -> dict[str, float]:
    """Return intrinsics under nerfstudio's names; its pixel coordinates are COLMAP's."""
    (fl_x, fl_y), (cx, cy) = camera.focal, camera.principal
    names = ("k1", "k2", "k3", "k4") if camera.is_fisheye else ("k1", "k2", "p1", "p2")
    return {
        "w": camera.width,
        "h": camera.height,
        "fl_x": fl_x,
        "fl_y": fl_y,
        "cx": cx,
        "cy": cy,
        **dict(zip(names, camera.distortion, strict=True)),
    }
