"""Export in the layout of Extended CMU Seasons: photographs, poses and map of each slice.

The licence of that data set forbids shipping it; a simulated drive in its layout replaces it in
tests. Pose files hold camera centres, not translations, with six decimals; photographs are
distorted.
"""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.colmap.models import write_with_poses
from objconnect.scene.errors import InputError
from objconnect.scene.exports.cmu_names import (
    CAMERAS,
    FIRST_SLICES,
    SIMULATED_HEADER,
    ImageName,
    surroundings,
)
from objconnect.scene.exports.lens import coefficients
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.photographs import PosedImage
from objconnect.scene.maps.sparse_map import MapImage, SparseMap


class _Photograph(NamedTuple):
    """One frame of the scene, with its name in the scene (``source``) and in the export.

    Attributes:
        source: name in the scene.
        name: name in the export.
        is_reference: whether it belongs to the map.
        camera: camera of the model OPENCV.
        cam_from_world: (4, 4).
    """

    source: str
    name: ImageName
    is_reference: bool
    camera: Camera
    cam_from_world: NDArray[np.float64]

    def line(self) -> str:
        """Return its line in a pose file: name, quaternion, camera centre."""
        pose = Pose.from_matrix(self.cam_from_world)
        numbers = [*pose.quaternion().tolist(), *pose.centre().tolist()]
        return " ".join([str(self.name), *(f"{x:.6f}" for x in numbers)]) + "\n"


def write(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    """Write a scene's map and queries as slices 2 (urban), 9 (suburban) and 18 (park).

    The surroundings of its camera determine the slice of a photograph. The poses of all queries
    are included, the SIFT databases of the real data set are not. See ``formats.Writer``.

    Raises:
        InputError: the scene has no surroundings or no map, its photographs are not of two cameras
            that OPENCV can describe, or a slice would have queries without a map.
    """
    cameras = _name_cameras(sessions)
    slices: dict[str, list[_Photograph]] = {name: [] for name in FIRST_SLICES}
    for part, photograph in _photographs(scene, sessions, cameras):
        if part not in slices:
            raise InputError(
                f"{scene.path}: {photograph.source} was taken in no urban, suburban or park part: "
                "simulate a scene with --preset street"
            )
        slices[part].append(photograph)
    sparse_map = scene.sparse_map()
    lines = [f"{name} {_convert_to_opencv(camera)}\n" for camera, name in cameras.items()]
    (folder / "intrinsics.txt").write_text(
        f"{SIMULATED_HEADER}\n# camera model w h fx fy cx cy k1 k2 p1 p2\n" + "".join(lines),
        "utf-8",
    )
    (folder / "README.md").write_text(
        f"Simulated by ObjConnect (preset {scene.manifest.preset}, seed {scene.manifest.seed}) in "
        "the tree of Extended CMU Seasons. No photograph of that data set is in it.\n",
        "utf-8",
    )
    for part, photographs in slices.items():
        if photographs:
            _write_slice(scene, sparse_map, FIRST_SLICES[part], photographs, folder)


def _name_cameras(sessions: Mapping[str, Frames]) -> dict[Camera, str]:
    """Return the name of each camera, in the order of the sessions."""
    cameras = list(dict.fromkeys(c for frames in sessions.values() for c in frames.cameras))
    if len(cameras) != len(CAMERAS):
        raise InputError(
            f"this format has two cameras, c0 and c1, and these sessions have {len(cameras)}: "
            "simulate sessions with exactly two cameras"
        )
    if any(camera.is_fisheye for camera in cameras):
        raise InputError("this format cannot hold a fisheye, only OPENCV cameras: export as colmap")
    return dict(zip(cameras, CAMERAS, strict=True))


def _convert_to_opencv(camera: Camera) -> Camera:
    """Convert a camera to the model OPENCV.

    Raises:
        InputError: the lens has coefficients that OPENCV lacks.
    """
    distortion = coefficients(camera, ("k1", "k2", "p1", "p2"), "the tree of Extended CMU Seasons")
    params = (*camera.focal, *camera.principal, *distortion.values())
    return Camera("OPENCV", camera.width, camera.height, params)


def _photographs(
    scene: Scene, sessions: Mapping[str, Frames], cameras: Mapping[Camera, str]
) -> Iterator[tuple[str | None, _Photograph]]:
    """Yield the surroundings and the photograph of every frame, numbered from 1."""
    map_names = set(scene.splits.map)
    number = 0
    for frames in sessions.values():
        parts = scene.objects.surroundings_at(frames.poses.centre().numpy())
        for k, part in enumerate(parts):
            number += 1
            camera = frames.cameras[k]
            name = ImageName(number, cameras[camera], round(1e6 * float(frames.time[k])))
            source = frames.names[k]
            pose = frames.cam_from_world[k]
            opencv = _convert_to_opencv(camera)
            yield part, _Photograph(source, name, source in map_names, opencv, pose)


def _write_slice(
    scene: Scene, scene_map: SparseMap, number: int, photographs: list[_Photograph], root: Path
) -> None:
    """Write the photographs, poses and map of one slice into the folder ``root``."""
    name = f"slice{number}"
    folder = root / name
    for subfolder in ("database", "query", "camera-poses", "sparse"):
        (folder / subfolder).mkdir(parents=True)
    for photograph in photographs:
        target = folder / ("database" if photograph.is_reference else "query")
        shutil.copyfile(scene.images_root / photograph.source, target / str(photograph.name))
    references = [p for p in photographs if p.is_reference]
    queries = [p for p in photographs if not p.is_reference]
    images = [PosedImage(str(p.name), p.camera, p.cam_from_world) for p in references]
    sparse_map = _submap(scene_map, references)
    if not len(sparse_map.xyz):
        raise InputError(
            f"the map of {scene.path} has no point that at least two photographs of its "
            f"{surroundings(number)} part see: fly more map frames there"
        )
    write_with_poses(images, sparse_map, folder / "sparse")
    ground_truth = "".join(p.line() for p in references)
    (folder / f"ground-truth-database-images-{name}.txt").write_text(ground_truth, "utf-8")
    query_list = "".join(f"{p.name}\n" for p in queries)
    (folder / f"test-images-{name}.txt").write_text(query_list, "utf-8")
    for day in sorted({p.name.day for p in queries}):
        file = folder / "camera-poses" / f"slice-{number}-gt-query-images-{day:%Y%m%d}.txt"
        file.write_text("".join(p.line() for p in queries if p.name.day == day), "utf-8")


def _submap(scene_map: SparseMap, references: list[_Photograph]) -> SparseMap:
    """Return the map of the reference photographs, under their names in the export.

    It holds the points that at least two of them observe.
    """
    map_photographs = [p for p in references if p.source in scene_map.images]
    observations = np.zeros(len(scene_map.xyz), np.int64)
    for photograph in map_photographs:
        rows = scene_map.images[photograph.source].point_rows
        observations += np.bincount(rows[rows >= 0], minlength=len(observations))
    rows_to_export = np.flatnonzero(observations >= 2)
    row_of = np.full(len(observations) + 1, -1)  # the last entry maps -1 (no point) to itself
    row_of[rows_to_export] = np.arange(len(rows_to_export))

    def rename(photograph: _Photograph) -> MapImage:
        image = scene_map.images[photograph.source]
        return dataclasses.replace(
            image,
            name=str(photograph.name),
            camera=photograph.camera,
            point_rows=row_of[image.point_rows],
        )

    return SparseMap(
        images={str(p.name): rename(p) for p in map_photographs},
        xyz=scene_map.xyz[rows_to_export],
        rgb=scene_map.rgb[rows_to_export],
        error=scene_map.error[rows_to_export],
        track_length=observations[rows_to_export],
    )
