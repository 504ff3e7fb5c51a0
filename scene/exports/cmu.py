"""Extended CMU Seasons: what its names mean, and simulated drives written in its tree.

Its licence forbids shipping it, so a set made here stands in for it. Facts of the format: pose
files hold the camera's CENTRE, not a translation, with six decimals; photographs are distorted;
each image's camera, c0 or c1, and its moment are in its name; a slice is of one kind of
surroundings.
"""

from __future__ import annotations

import dataclasses
import re
import shutil
from collections.abc import Iterator, Mapping
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scene.bundle.frames import Frames
from scene.bundle.scene import Scene
from scene.colmap.models import write_posed
from scene.errors import InputError
from scene.geometry.camera import Camera
from scene.geometry.pose import Pose
from scene.maps.photographs import PosedImage
from scene.maps.sparse_map import MapImage, SparseMap

# First line of intrinsics.txt in a tree of simulated photographs. Without it figures on them would
# pass for figures on the real ones: every other name is the same.
SIMULATED: Final = "# simulated by ObjConnect"

CAMERAS: Final = ("c0", "c1")
_IMAGE: Final = re.compile(r"img_(\d+)_(c[01])_(\d+)us\.jpg")
# Pittsburgh: a day there is no day of UTC.
_LOCAL: Final = timedelta(hours=-5)
# The first slice of each surroundings.
_FIRST: Final = {"urban": 2, "suburban": 9, "park": 18}


class ImageName(NamedTuple):
    """What the name of an image says: number, camera and microseconds since 1970."""

    number: int
    camera: str
    microseconds: int

    @staticmethod
    def parse(name: str) -> ImageName:
        """InputError: the name is not of this data set."""
        found = _IMAGE.fullmatch(name)
        if found is None:
            raise InputError(
                f"image {name!r} is not named like img_00119_c0_1303398474779439us.jpg"
            )
        return ImageName(int(found[1]), found[2], int(found[3]))

    @property
    def day(self) -> date:
        """The day of the photograph where the data set was taken."""
        return (datetime.fromtimestamp(self.microseconds / 1e6, UTC) + _LOCAL).date()

    def __str__(self) -> str:
        return f"img_{self.number:05d}_{self.camera}_{self.microseconds}us.jpg"


def surroundings(number: int) -> Literal["urban", "suburban", "park"]:
    """Urban, suburban or park, by the number of the slice."""
    if number < _FIRST["suburban"]:
        return "urban"
    return "suburban" if number < _FIRST["park"] else "park"


class _Photograph(NamedTuple):
    """One frame of the scene and where it goes."""

    source: str
    name: ImageName
    is_reference: bool
    camera: Camera
    cam_from_world: NDArray[np.float64]

    def line(self) -> str:
        """Its pose as the data set writes it: quaternion of the rotation, then the centre."""
        pose = Pose.from_matrix(self.cam_from_world)
        numbers = [*pose.quaternion().tolist(), *pose.centre().tolist()]
        return " ".join([str(self.name), *(f"{x:.6f}" for x in numbers)]) + "\n"


def write_cmu(scene: Scene, sessions: Mapping[str, Frames], folder: Path) -> None:
    """Write a scene's map and queries as slices 2 (urban), 9 (suburban) and 18 (park).

    A photograph belongs to the slice whose surroundings its camera stands in. Every pose of a query
    is public. SIFT databases, which the real set has, are left out.

    Args:
        scene: whose objects name surroundings, with its map.
        sessions: to write.
        folder: existing, empty.

    Raises:
        InputError: the place has no surroundings, the scene no map, the photographs are not of two
            cameras whose distortion OPENCV can say, or a slice would have queries and no map.
    """
    cameras = _two_cameras(sessions)
    slices: dict[str, list[_Photograph]] = {name: [] for name in _FIRST}
    for part, photograph in _photographs(scene, sessions, cameras):
        if part not in slices:
            raise InputError(
                f"{scene.path}: {photograph.source} was taken in no urban, suburban or park part: "
                "simulate a scene with --preset street"
            )
        slices[part].append(photograph)
    sparse_map = scene.sparse_map()
    lines = [f"{name} {_opencv(camera)}\n" for camera, name in cameras.items()]
    (folder / "intrinsics.txt").write_text(
        f"{SIMULATED}\n# camera model w h fx fy cx cy k1 k2 p1 p2\n" + "".join(lines), "utf-8"
    )
    (folder / "README.md").write_text(
        f"Simulated by ObjConnect (preset {scene.manifest.preset}, seed {scene.manifest.seed}) in "
        "the tree of Extended CMU Seasons. No photograph of that data set is in it.\n",
        "utf-8",
    )
    for part, photographs in slices.items():
        if photographs:
            _write_slice(scene, sparse_map, _FIRST[part], photographs, folder)


def _two_cameras(sessions: Mapping[str, Frames]) -> dict[Camera, str]:
    """The cameras by the names they get, in the order of the sessions."""
    cameras = list(dict.fromkeys(c for frames in sessions.values() for c in frames.cameras))
    if len(cameras) != len(CAMERAS):
        raise InputError(
            f"this tree is of two cameras, c0 and c1, and these sessions have {len(cameras)}: give "
            "half of them another camera"
        )
    if any(camera.is_fisheye for camera in cameras):
        raise InputError("this tree is of OPENCV cameras: a fisheye is none")
    return dict(zip(cameras, CAMERAS, strict=True))


def _opencv(camera: Camera) -> Camera:
    """The same camera under the model of this data set."""
    params = (*camera.focal, *camera.principal, *camera.distortion)
    return Camera("OPENCV", camera.width, camera.height, params)


def _photographs(
    scene: Scene, sessions: Mapping[str, Frames], cameras: Mapping[Camera, str]
) -> Iterator[tuple[str | None, _Photograph]]:
    """Every frame with the surroundings it was taken in, numbered from 1."""
    mapped = set(scene.splits.map)
    number = 0
    for frames in sessions.values():
        parts = scene.objects.surroundings_at(frames.poses.centre().numpy())
        for k, part in enumerate(parts):
            number += 1
            camera = frames.cameras[k]
            name = ImageName(number, cameras[camera], round(1e6 * float(frames.time[k])))
            source = frames.names[k]
            pose = frames.cam_from_world[k]
            yield part, _Photograph(source, name, source in mapped, _opencv(camera), pose)


def _write_slice(
    scene: Scene, whole: SparseMap, number: int, photographs: list[_Photograph], root: Path
) -> None:
    name = f"slice{number}"
    folder = root / name
    for part in ("database", "query", "camera-poses", "sparse"):
        (folder / part).mkdir(parents=True)
    for photograph in photographs:
        place = folder / ("database" if photograph.is_reference else "query")
        shutil.copyfile(scene.images_root / photograph.source, place / str(photograph.name))
    references = [p for p in photographs if p.is_reference]
    queries = [p for p in photographs if not p.is_reference]
    images = [PosedImage(str(p.name), p.camera, p.cam_from_world) for p in references]
    sparse_map = _submap(whole, references)
    if not len(sparse_map.xyz):
        raise InputError(
            f"the map of {scene.path} has no point that two photographs of its "
            f"{surroundings(number)} part see: fly more map frames there"
        )
    write_posed(images, sparse_map, folder / "sparse")
    ground_truth = "".join(p.line() for p in references)
    (folder / f"ground-truth-database-images-{name}.txt").write_text(ground_truth, "utf-8")
    listed = "".join(f"{p.name}\n" for p in queries)
    (folder / f"test-images-{name}.txt").write_text(listed, "utf-8")
    for day in sorted({p.name.day for p in queries}):
        file = folder / "camera-poses" / f"slice-{number}-gt-query-images-{day:%Y%m%d}.txt"
        file.write_text("".join(p.line() for p in queries if p.name.day == day), "utf-8")


def _submap(whole: SparseMap, references: list[_Photograph]) -> SparseMap:
    """What two or more of the references observe, under their new names."""
    mapped = [p for p in references if p.source in whole.images]
    seen = np.zeros(len(whole.xyz), np.int64)
    for photograph in mapped:
        rows = whole.images[photograph.source].point_rows
        seen += np.bincount(rows[rows >= 0], minlength=len(seen))
    kept = np.flatnonzero(seen >= 2)
    row_of = np.full(len(seen) + 1, -1)  # the last stands for no point
    row_of[kept] = np.arange(len(kept))

    def renamed(photograph: _Photograph) -> MapImage:
        image = whole.images[photograph.source]
        return dataclasses.replace(
            image,
            name=str(photograph.name),
            camera=photograph.camera,
            point_rows=row_of[image.point_rows],
        )

    return SparseMap(
        images={str(p.name): renamed(p) for p in mapped},
        xyz=whole.xyz[kept],
        rgb=whole.rgb[kept],
        error=whole.error[kept],
        track_length=seen[kept],
    )
