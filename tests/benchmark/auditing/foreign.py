"""A rendered scene as a project of other programs, with one fault planted where asked.

Every fault is planted in the numbers of the file, by formulas of this module: not by the readers
that are tested.
"""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.colmap.models import write_with_poses
from objconnect.scene.geometry.geodesy import geodetic_from_enu
from objconnect.scene.geometry.pose import Pose, so3_log
from objconnect.scene.maps.photographs import PosedImage
from objconnect.scene.maps.sparse_map import SparseMap

SESSION = "map-summer-noon-nadir"

Document = dict[str, object]


def frames_of(scene: Scene) -> Frames:
    """The frames of the session that the map is of."""
    return scene.frames(next(name for name in scene.sessions if scene.sessions[name].role == "map"))


def photographs(scene: Scene, folder: Path) -> list[str]:
    """Copy the photographs to a folder; return their new names, in order."""
    folder.mkdir(parents=True)
    names = []
    for name in frames_of(scene).names:
        names.append(Path(name).name)
        shutil.copyfile(scene.images_root / name, folder / names[-1])
    return names


def colmap(
    scene: Scene,
    root: Path,
    poses: Callable[[np.ndarray], np.ndarray] = lambda matrices: matrices,
    keypoints: float = 0.0,
    focal: float = 1.0,
) -> Path:
    """A COLMAP project: ``images`` and ``sparse/0``.

    Args:
        scene: rendered.
        root: folder of the project, made here.
        poses: from cam_from_world (N, 4, 4) to what is written in its place.
        keypoints: pixels added to every keypoint.
        focal: factor on the focal lengths.
    """
    names = photographs(scene, root / "images")
    frames, sparse_map = frames_of(scene), scene.sparse_map()
    camera = frames.cameras[0]
    fx, fy, cx, cy = camera.params
    camera = replace(camera, params=(fx * focal, fy * focal, cx, cy))
    written = poses(frames.cam_from_world.copy())
    images = {
        name: replace(
            sparse_map.images[old],
            name=name,
            camera=camera,
            cam_from_world=pose,
            xy=sparse_map.images[old].xy + keypoints,
        )
        for name, old, pose in zip(names, frames.names, written, strict=True)
    }
    folder = root / "sparse" / "0"
    folder.mkdir(parents=True)
    posed = [PosedImage(i.name, i.camera, i.cam_from_world) for i in images.values()]
    whole = SparseMap(
        images, sparse_map.xyz, sparse_map.rgb, sparse_map.error, sparse_map.track_length
    )
    write_with_poses(posed, whole, folder)
    return root


def nerfstudio(
    scene: Scene,
    root: Path,
    change: Callable[[list[np.ndarray], Document], None] = lambda matrices, document: None,
    opengl: bool = True,
) -> Path:
    """A nerfstudio project: ``images`` and ``transforms.json``.

    Args:
        scene: rendered.
        root: folder of the project, made here.
        change: changes the matrices and the document before they are written.
        opengl: whether camera axes are OpenGL's, as the format has them.
    """
    names = photographs(scene, root / "images")
    frames = frames_of(scene)
    fx, fy, cx, cy = frames.cameras[0].params
    document: Document = {"camera_model": "OPENCV", "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}
    document |= {"w": frames.cameras[0].width, "h": frames.cameras[0].height}
    matrices = [np.linalg.inv(matrix) for matrix in frames.cam_from_world]
    if opengl:
        matrices = [matrix @ np.diag([1.0, -1, -1, 1]) for matrix in matrices]
    change(matrices, document)
    document["frames"] = [
        {"file_path": f"images/{name}", "transform_matrix": matrix.tolist()}
        for name, matrix in zip(names, matrices, strict=True)
    ]
    (root / "transforms.json").write_text(json.dumps(document))
    return root


def tum(scene: Scene, root: Path, wxyz: bool = False, late: int = 0) -> Path:
    """A TUM project: ``rgb`` and ``trajectory.txt``.

    Args:
        scene: rendered.
        root: folder of the project, made here.
        wxyz: whether quaternions are written w x y z instead of x y z w.
        late: by how many photographs poses are late.
    """
    names = photographs(scene, root / "rgb")
    frames = frames_of(scene)
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    times = [f"{time:.3f}" for time in frames.time]
    for name, time in zip(names, times, strict=True):
        (root / "rgb" / name).rename(root / "rgb" / f"{time}.jpg")
    world_from_cam = [np.linalg.inv(matrix) for matrix in frames.cam_from_world]
    for time, matrix in zip(times, np.roll(world_from_cam, late, axis=0), strict=True):
        w, x, y, z = Pose.from_matrix(matrix).quaternion().tolist()
        quaternion = (w, x, y, z) if wxyz else (x, y, z, w)
        numbers = [*matrix[:3, 3].tolist(), *quaternion]
        lines.append(" ".join([time, *(f"{number:.9f}" for number in numbers)]))
    (root / "trajectory.txt").write_text("\n".join(lines) + "\n")
    return root


def odm(scene: Scene, root: Path, swapped: bool = False, up: float = 0.0) -> Path:
    """A project of OpenDroneMap: ``images`` and ``opensfm/reconstruction.json``.

    Args:
        scene: rendered.
        root: folder of the project, made here.
        swapped: whether latitude and longitude of the reference are swapped.
        up: metres added to its altitude.
    """
    names = photographs(scene, root / "images")
    frames, origin = frames_of(scene), scene.manifest.origin
    assert origin is not None
    camera = frames.cameras[0]
    shots = {}
    for name, matrix in zip(names, frames.cam_from_world, strict=True):
        vector = so3_log(torch.from_numpy(matrix[:3, :3])).tolist()
        shots[name] = {"rotation": vector, "translation": matrix[:3, 3].tolist(), "camera": "one"}
        shots[name]["gps_position"] = (-matrix[:3, :3].T @ matrix[:3, 3]).tolist()
    lens = {"projection_type": "perspective", "width": camera.width, "height": camera.height}
    lens |= {"focal": camera.params[0] / max(camera.width, camera.height), "k1": 0.0, "k2": 0.0}
    lat, lon = origin.latitude, origin.longitude
    reference = {
        "latitude": lon if swapped else lat,
        "longitude": lat if swapped else lon,
        "altitude": origin.altitude + up,
    }
    document = [{"cameras": {"one": lens}, "shots": shots, "reference_lla": reference}]
    (root / "opensfm").mkdir()
    (root / "opensfm" / "reconstruction.json").write_text(json.dumps(document))
    return root


def table(
    scene: Scene, root: Path, change: Callable[[np.ndarray], np.ndarray] = lambda rows: rows
) -> Path:
    """A folder of photographs with a table of their exact positions; return the table.

    Args:
        scene: rendered.
        root: folder of the project, made here.
        change: from latitude, longitude and altitude (N, 3) to what is written.
    """
    names = photographs(scene, root / "images")
    origin = scene.manifest.origin
    assert origin is not None
    centres = frames_of(scene).poses.centre().numpy()
    rows = change(np.array([geodetic_from_enu(centre, origin) for centre in centres]))
    with (root / "positions.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["name", "lat", "lon", "alt"])
        writer.writerows([name, *row] for name, row in zip(names, rows.tolist(), strict=True))
    return root / "positions.csv"


def halve(file: Path) -> None:
    """Resize a photograph to half its size."""
    with Image.open(file) as image:
        exif, small = image.info["exif"], image.resize((image.width // 2, image.height // 2))
    small.save(file, exif=exif)
