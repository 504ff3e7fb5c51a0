"""Export to rerun: ``scene.rrd`` for the viewer of https://rerun.io.

The world is right-handed with Z up. Each session (flight) has a trajectory, and cameras on the time
lines ``frame`` (number in the session) and ``time`` (if photographs have a time). Cameras are
pinholes, because rerun draws no distortion. The map's points are static.

Only this module imports rerun, which the extra ``[rerun]`` installs.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.runtime.extras import import_extra
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.files import require_disk_space, require_readable

_FILE = "scene.rrd"
_ORANGE = (255, 140, 0)
# A disk with less free space is treated as full, because rerun only logs a full disk and truncates
# the file.
_MIN_FREE_BYTES = 1 << 20


def write(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    """Write ``scene.rrd`` without photographs; see ``formats.Writer``.

    Raises:
        InputError: rerun is not installed.
        WriteError: the disk is full.
    """
    _write(scene, sessions, folder / _FILE, photographs=False)


def write_with_images(
    scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path
) -> None:
    """Write ``scene.rrd`` with the photographs; see ``formats.Writer``.

    Raises:
        InputError: rerun is not installed.
        WriteError: the disk is full.
    """
    _write(scene, sessions, folder / _FILE, photographs=True)


def _write(scene: Scene, sessions: Mapping[str, Frames], path: Path, photographs: bool) -> None:
    rr = import_extra("rerun", "rerun", "export to rerun")
    require_disk_space(path, _MIN_FREE_BYTES)
    stream = rr.RecordingStream("objconnect", recording_id=scene.name)
    stream.save(path)
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if scene.map_path.is_dir():
        sparse_map = scene.sparse_map()
        stream.log("world/map", rr.Points3D(sparse_map.xyz, colors=sparse_map.rgb), static=True)
    for session, frames in sessions.items():
        line = rr.LineStrips3D([frames.poses.centre().numpy()], colors=[_ORANGE])
        stream.log(["world", session, "trajectory"], line, static=True)
    moments = [(session, k) for session, frames in sessions.items() for k in range(len(frames))]
    with progress_bar("write frames", len(moments)) as advance:
        for done, (session, k) in enumerate(moments, 1):
            frames, entity = sessions[session], ["world", session, "camera"]
            stream.reset_time()
            stream.set_time("frame", sequence=k)
            if np.isfinite(frames.time[k]):
                stream.set_time("time", timestamp=float(frames.time[k]))
            _log_camera(rr, stream, entity, frames, k)
            if photographs:
                photograph = scene.images_root / frames.names[k]
                require_readable(photograph, "photograph")
                stream.log(entity, rr.EncodedImage(path=photograph))
            advance(done)
    stream.flush()
    stream.disconnect()
    require_disk_space(path, _MIN_FREE_BYTES)


def _log_camera(rr: Any, stream: Any, entity: list[str], frames: Frames, k: int) -> None:
    """Log pose and pinhole of one frame; the entity has OpenCV's camera axes."""
    world_from_cam = np.linalg.inv(frames.cam_from_world[k])
    camera = frames.cameras[k]
    stream.log(
        entity,
        rr.Transform3D(translation=world_from_cam[:3, 3], mat3x3=world_from_cam[:3, :3]),
        rr.Pinhole(
            image_from_camera=camera.calibration,
            width=camera.width,
            height=camera.height,
            camera_xyz=rr.ViewCoordinates.RDF,
        ),
        rr.TextDocument(frames.names[k]),
    )
