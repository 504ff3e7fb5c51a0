"""A scene's frames in the formats of other programs, all from the same ``Frames``."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from scene.bundle.covisibility import COVISIBLE
from scene.bundle.frames import Frames
from scene.bundle.scene import Scene
from scene.colmap.models import write_posed
from scene.errors import InputError
from scene.exports.cmu import write_cmu
from scene.geometry.camera import Camera
from scene.maps.photographs import PosedImage
from scene.storage.files import folder_written_whole
from scene.storage.names import written
from scene.storage.outputs import claim_folder

Format = Literal["colmap", "nerfstudio", "tum", "hloc", "cmu"]

# Retrieval of hloc hands over so many photographs of the map for each query.
_PAIRS_PER_QUERY = 20


def export(
    path: Path, file_format: Format, out: Path, sessions: Sequence[str] = ()
) -> dict[str, Any]:
    """Write the frames of a scene in another program's format; whole or not at all.

    colmap: a binary model of all frames' poses in world metres, with the points of the map and
    their observations where there is a map. Image names are relative to the scene's ``sessions``.

    nerfstudio: ``transforms.json``, with OpenGL camera axes and paths to the scene's photographs
    relative to it.

    tum: ``SESSION.txt`` per session, lines "timestamp tx ty tz qx qy qz qw" of world_from_cam, as
    the benchmark of RGB-D SLAM systems defines it (Sturm et al., IROS 2012); seconds and metres.

    hloc: ``queries_with_intrinsics.txt`` ("name MODEL width height params..."), ``pairs-map.txt``
    of the map's covisible frames, and ``pairs-query.txt`` of each query with up to 20 map frames
    that see most of it: perfect retrieval, an upper bound.

    cmu: photographs, poses and map in the tree of Extended CMU Seasons, a slice for each
    surroundings; see ``scene.exports.cmu``.

    Args:
        path: of a finished scene.
        file_format: one of the above.
        out: folder, new or empty.
        sessions: names; none means all.

    Returns:
        The folder, the format and the number of frames written.

    Raises:
        InputError: not a finished scene, no such session, ``out`` holds something, nothing to
            write, ``out`` lies in the scene, or a camera that the format cannot hold.
    """
    if file_format not in get_args(Format):
        raise InputError(
            f"unknown format {file_format!r}: choose one of {', '.join(get_args(Format))}"
        )
    scene = Scene.open(path)
    if out.resolve().is_relative_to(path.resolve()):
        raise InputError(f"{out} lies in the scene itself: choose a folder outside it")
    chosen = {name: scene.frames(name) for name in dict.fromkeys(sessions or scene.sessions)}
    require_empty(out)
    claim_folder(out, [path])
    write = _WRITERS[file_format]
    with folder_written_whole(out) as folder:
        write(scene, chosen, folder, out)
    frames = sum(len(frames) for frames in chosen.values())
    return {"out": str(out), "format": file_format, "frames": frames, "sessions": list(chosen)}


def require_empty(out: Path) -> None:
    """InputError unless an export can be written to a folder: it is new or empty."""
    try:
        occupied = out.exists() and any(out.iterdir())
    except OSError as error:
        raise InputError(f"cannot use {out} for an export: {error.strerror}") from None
    if occupied:
        raise InputError(f"{out} is not empty: choose another folder or remove it")


def _write_colmap(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    images = [
        PosedImage(name, camera, pose)
        for frames in sessions.values()
        for name, camera, pose in zip(
            frames.names, frames.cameras, frames.cam_from_world, strict=True
        )
    ]
    sparse_map = scene.sparse_map() if scene.map_path.is_dir() else None
    write_posed(images, sparse_map, folder)


def _write_nerfstudio(
    scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path
) -> None:
    cameras = list(dict.fromkeys(c for frames in sessions.values() for c in frames.cameras))
    if len({camera.is_fisheye for camera in cameras}) > 1:
        raise InputError(
            "transforms.json has one camera model, and these sessions fly perspective and fisheye "
            "cameras: export them apart with --session"
        )
    shared = _nerfstudio_camera(cameras[0]) if len(cameras) == 1 else {}
    root = os.path.relpath(scene.images_root.resolve(), final.resolve())
    frames_json = []
    for frames in sessions.values():
        world_from_cam = frames.poses.inverse().matrix().numpy()
        # OpenGL's camera looks along -z with y up.
        transforms = world_from_cam @ np.diag([1.0, -1.0, -1.0, 1.0])
        for name, camera, transform in zip(frames.names, frames.cameras, transforms, strict=True):
            own = {} if shared else _nerfstudio_camera(camera)
            file_path = (Path(root) / name).as_posix()
            frames_json.append(
                {"file_path": file_path, **own, "transform_matrix": transform.tolist()}
            )
    model = "OPENCV_FISHEYE" if cameras[0].is_fisheye else "OPENCV"
    document = {"camera_model": model, **shared, "frames": frames_json}
    (folder / "transforms.json").write_text(json.dumps(document, indent=1) + "\n", "utf-8")


def _nerfstudio_camera(camera: Camera) -> dict[str, float]:
    """Intrinsics under nerfstudio's names; its pixels are COLMAP's."""
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


def _write_tum(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    for name, frames in sessions.items():
        if np.isnan(frames.time).any():
            raise InputError(
                f"photographs of session {name} tell no time, and a trajectory needs it"
            )
        world_from_cam = frames.poses.inverse()
        wxyz = world_from_cam.quaternion().numpy()
        rows = np.hstack([world_from_cam.translation.numpy(), np.roll(wxyz, -1, axis=1)])
        lines = [
            f"{time:.6f} {' '.join(repr(value) for value in row)}\n"
            for time, row in zip(frames.time.tolist(), rows.tolist(), strict=True)
        ]
        header = "# timestamp tx ty tz qx qy qz qw (world_from_cam: seconds, metres)\n"
        (folder / f"{name}.txt").write_text(header + "".join(lines), "utf-8")


def _write_hloc(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    cameras = {
        name: camera
        for frames in sessions.values()
        for name, camera in zip(frames.names, frames.cameras, strict=True)
    }
    mapped = set(scene.splits.map)
    queries = [name for name in cameras if name not in mapped]
    if not queries:
        raise InputError("these sessions have no query: name a session of queries")
    references = scene.splits.map
    among = scene.covisibility.of([*references, *queries])
    mutual = among.mutual[: len(references), : len(references)]
    map_pairs = [
        f"{written(references[i])} {written(references[j])}\n"
        for i, j in np.argwhere(np.triu(mutual) >= COVISIBLE)
    ]
    query_pairs = []
    for k, query in enumerate(queries, len(references)):
        shares = among.overlap[k, : len(references)]
        best = np.argsort(-shares, kind="stable")[:_PAIRS_PER_QUERY]
        seen = [references[j] for j in best if shares[j] >= COVISIBLE]
        query_pairs += [f"{written(query)} {written(name)}\n" for name in seen]
    lists = {
        "queries_with_intrinsics.txt": [f"{written(name)} {cameras[name]}\n" for name in queries],
        "pairs-map.txt": map_pairs,
        "pairs-query.txt": query_pairs,
    }
    for file, lines in lists.items():
        (folder / file).write_text("".join(lines), "utf-8")


_WRITERS: dict[Format, Callable[[Scene, Mapping[str, Frames], Path, Path], None]] = {
    "colmap": _write_colmap,
    "nerfstudio": _write_nerfstudio,
    "tum": _write_tum,
    "hloc": _write_hloc,
    "cmu": lambda scene, sessions, folder, final: write_cmu(scene, sessions, folder),
}
