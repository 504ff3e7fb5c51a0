"""Short descriptions (*records*) of rendered scenes, to compare renders of different machines.

Renders differ in single bits between kinds of processors and versions of libraries, so that their
digests differ. The record describes each photograph by few numbers: its camera, its pose and the
mean brightness of blocks. Two renders are alike if these agree and the maps have similar sizes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from objconnect.scene.bundle.manifest import read_json
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.packed import XZ_SUFFIX, pack
from objconnect.scene.storage.records import Record

# Blocks per side of a photograph, and decimals of their brightness.
_BLOCKS: Final = 8
_DECIMALS: Final = 1
# Decimals of poses: micrometres.
_POSE_DECIMALS: Final = 6
# Renders are alike if no difference is larger than these: of the brightness of a block (grey
# levels) and of a number of a pose (metres for translations), and the relative differences of a
# camera parameter and of the number of map points. With kernels of another instruction set, renders
# of a park differ by up to 0.06 grey levels; a car in another position changes a block by several.
_BRIGHTNESS: Final = 0.5
_POSITION_M: Final = 1e-5
_CAMERA_SHARE: Final = 1e-9
_MAP_SHARE: Final = 0.02


def render_path(folder: Path, dataset: str) -> Path:
    """Return the file, in the folder of a track, that describes the render of a data set."""
    return folder / "renders" / f"{dataset}.json{XZ_SUFFIX}"


class RenderedFrame(Record):
    """A frame of a render.

    Attributes:
        name: image name, relative to the scene's ``sessions`` folder.
        camera: camera model, size and parameters, in words.
        cam_from_world: first three rows of the pose, row by row.
        blocks: mean brightness of 8 x 8 blocks, row by row, grey levels.
    """

    name: str
    camera: str
    cam_from_world: tuple[float, ...] = Field(min_length=12, max_length=12)
    blocks: tuple[float, ...] = Field(min_length=_BLOCKS**2, max_length=_BLOCKS**2)


class Render(Record):
    """The record of a rendered and mapped scene: all its frames, and the size of its map."""

    frames: tuple[RenderedFrame, ...] = Field(min_length=1)
    map_points: int = Field(ge=0)


def render_of(scene: Scene) -> Render:
    """Return the record of a rendered and mapped scene.

    Raises:
        InputError: a list, a photograph or the map is missing or damaged.
    """
    frames = []
    sessions = [scene.frames(name) for name in scene.sessions]
    with progress_bar("record of the render", sum(map(len, sessions))) as advance:
        for session in sessions:
            poses = session.cam_from_world
            for name, camera, pose in zip(session.names, session.cameras, poses, strict=True):
                rows = np.round(pose[:3].ravel(), _POSE_DECIMALS).tolist()
                blocks = _blocks(read_rgb(scene.images_root / name))
                frame = RenderedFrame(
                    name=name, camera=str(camera), cam_from_world=rows, blocks=blocks
                )
                frames.append(frame)
                advance(len(frames))
    return Render(frames=tuple(frames), map_points=len(scene.sparse_map().xyz))


def write_render(path: Path, render: Render) -> None:
    """Write a record compressed, atomically; its name ends in ``.json.xz``.

    Raises:
        InputError: the folder cannot be written.
    """
    with atomic_write(path) as partial:
        partial.write_bytes(pack(render.model_dump_json()))


def read_render(path: Path) -> Render:
    """Read a record that ``write_render`` wrote.

    Raises:
        InputError: the file is missing, damaged or not such a record.
    """
    return read_json(path, Render, "record of a render")


def difference(recorded: Render, render: Render) -> str:
    """Describe in words why two renders are not alike; the text is empty if they are."""
    recorded_names = [frame.name for frame in recorded.frames]
    names = [frame.name for frame in render.frames]
    if names != recorded_names:
        return "other frames"
    for former, current in zip(recorded.frames, render.frames, strict=True):
        if not _is_same_camera(former.camera, current.camera):
            return f"another camera of {current.name}"
    pose = _largest_differences(recorded, render, "cam_from_world")
    if pose.max() > _POSITION_M:
        return f"another pose of {names[int(pose.argmax())]}"
    brightness = _largest_differences(recorded, render, "blocks")
    if brightness.max() > _BRIGHTNESS:
        worst = int(brightness.argmax())
        return f"{names[worst]} differs by {brightness[worst]:.1f} grey levels"
    if abs(render.map_points - recorded.map_points) > _MAP_SHARE * recorded.map_points:
        return f"a map of {render.map_points} points, not {recorded.map_points}"
    return ""


def _blocks(rgb: NDArray[np.uint8]) -> tuple[float, ...]:
    """Return the mean brightness of the blocks of a photograph (H, W, 3)."""
    grey = rgb.astype(np.float32).mean(-1)
    means = cv2.resize(grey, (_BLOCKS, _BLOCKS), interpolation=cv2.INTER_AREA)
    return tuple(np.round(means.astype(np.float64).ravel(), _DECIMALS).tolist())


def _is_same_camera(words: str, others: str) -> bool:
    """Return whether cameras are equal up to rounding.

    Focal lengths are computed by tangents, whose last bits differ between processors.
    """
    if words == others:
        return True
    former, current = Camera.parse(words.split()), Camera.parse(others.split())
    if (former.model, former.width, former.height) != (
        current.model,
        current.width,
        current.height,
    ):
        return False
    return bool(np.allclose(current.params, former.params, rtol=_CAMERA_SHARE, atol=_CAMERA_SHARE))


def _largest_differences(recorded: Render, render: Render, field: str) -> NDArray[np.float64]:
    """Return the largest difference of a field's numbers for each frame, (N,)."""
    former, current = (
        np.array([getattr(frame, field) for frame in one.frames], np.float64)
        for one in (recorded, render)
    )
    return np.asarray(np.abs(current - former).max(1))
