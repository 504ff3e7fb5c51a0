"""Reader of Extended CMU Seasons: the slices whose query poses are public.

The reader takes the unchanged download, which differs from its README and from what public loaders
expect: pose files hold the camera's centre, not a translation; the name of each image states its
camera, c0 or c1; pose files may be empty; images are distorted, although an example image name
contains "rect" (rectified); the reference traversal is that of April 21, 2011, as its timestamps
show.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeVar

from benchmark.datasets.dataset import BenchmarkQuery, Dataset, Task, TaskQuery
from benchmark.datasets.identity import parts_of
from objconnect.scene.errors import InputError
from objconnect.scene.exports.cmu_names import CAMERAS, SIMULATED_HEADER, ImageName, surroundings
from objconnect.scene.flights.textfiles import read_cameras, read_poses
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.storage.files import read_text
from objconnect.scene.storage.listing import list_files

AnyTask = TypeVar("AnyTask", bound=Task)

TRACK: Final = "cmu"
SIMULATED_TRACK: Final = "cmu-sim"
INTRINSICS: Final = "intrinsics.txt"
"""Name of the file of the cameras."""

_SLICE: Final = re.compile(r"slice(\d+)")

# Descriptions of the days in the data set's README; other days are named by their date alone.
_DAYS: Final = {
    "2010-09-01": "sunny, foliage",
    "2010-09-15": "sunny, foliage",
    "2010-10-01": "cloudy, foliage",
    "2010-10-19": "sunny, foliage",
    "2010-10-28": "overcast, mixed foliage",
    "2010-11-03": "low sun, mixed foliage",
    "2010-11-12": "low sun, mixed foliage",
    "2010-11-22": "cloudy, mixed foliage",
    "2010-12-21": "low sun, no foliage, snow",
    "2011-03-04": "low sun, foliage",
    "2011-07-28": "overcast, foliage",
}


def is_cmu(path: Path) -> bool:
    """Return whether a folder is the data set, or one slice of it."""
    root = root_of(path)
    return (root / INTRINSICS).is_file() and bool(slice_folders(root))


def root_of(path: Path) -> Path:
    """Return the folder of the data set at a path, which may also be one of its slices."""
    root = path.resolve()
    return root.parent if _SLICE.fullmatch(root.name) else root


def open_cmu(path: Path) -> list[Dataset]:
    """Open every slice that has public query poses, or one slice.

    Raises:
        InputError: a file is missing or wrong, an image name has another form, or no slice has
            a public query pose.
    """
    folders, cameras = _find_slices(path)
    datasets = [d for folder in folders if (d := _open_slice(folder, cameras)) is not None]
    if not datasets:
        raise InputError(
            f"{path} has no public query pose in any camera-poses folder: for slices with hidden "
            "poses, use submit"
        )
    return datasets


class CmuReader:
    """Reads Extended CMU Seasons; see ``benchmark.datasets.open.Reader``."""

    name = "cmu"
    holds = f"{INTRINSICS} and slice folders (Extended CMU Seasons)"

    def recognizes(self, path: Path) -> bool:
        """Return whether a path is the folder of the data set, or of one slice of it."""
        return path.is_dir() and is_cmu(path)

    def open(self, path: Path) -> list[Dataset]:
        """Open the slices; ``open_cmu`` says which errors are raised."""
        return open_cmu(path)


READER: Final = CmuReader()


@dataclass(frozen=True, eq=False)
class Slice:
    """The query images of a slice, whether their poses are public or hidden.

    Attributes:
        folder: folder of the slice.
        queries: file names in its ``query`` folder, sorted.
        cameras: the cameras c0 and c1 by name.
    """

    folder: Path
    queries: tuple[str, ...]
    cameras: Mapping[str, Camera]

    def camera(self, name: str) -> Camera:
        """Return the camera that the name of an image states."""
        return self.cameras[ImageName.parse(name).camera]

    def restrict(self, names: Collection[str]) -> Slice:
        """Return the slice with only the query images that have these names."""
        return replace(self, queries=tuple(name for name in self.queries if name in names))

    def task(self) -> Task:
        """Return the slice as a data set without reference poses.

        Raises:
            InputError: a file of the map or a photograph is missing or cannot be read.
        """
        queries = tuple(_query(self.folder, name, self.cameras) for name in self.queries)
        return _build(Task, self.folder, queries)


def open_slices(path: Path) -> list[Slice]:
    """Find every slice with query images, or open the one slice that a path names.

    Raises:
        InputError: the path is not this data set, an image name has another form, or there is no
            query image.
    """
    if not is_cmu(path):
        raise InputError(
            f"{path} is not Extended CMU Seasons, nor a slice of it: give the folder that holds "
            f"{INTRINSICS}, or one of its slices"
        )
    folders, cameras = _find_slices(path)
    slices = []
    for folder in folders:
        names = list_queries(folder)
        for name in names:
            ImageName.parse(name)
        if names:
            slices.append(Slice(folder, names, cameras))
    if not slices:
        raise InputError(f"{path} holds no query image: add the folders slice*/query")
    return slices


def _find_slices(path: Path) -> tuple[list[Path], dict[str, Camera]]:
    """Return the folders of the slices at a path, and the two cameras."""
    return slice_folders(path), read_intrinsics(root_of(path))


def list_queries(folder: Path) -> tuple[str, ...]:
    """Return the names of the query images of a slice, sorted; empty without their folder."""
    photographs = folder / "query"
    images = list_files(photographs, (".jpg",)) if photographs.is_dir() else []
    return tuple(image.name for image in images)


def path_of_test_list(folder: Path) -> Path:
    """Return the path of the list of a slice's test images."""
    return folder / f"test-images-{folder.name}.txt"


def read_test_list(folder: Path) -> set[str]:
    """Read the names in the list of a slice's test images, one on each line.

    Raises:
        InputError: the file is missing or not a text file.
    """
    text = read_text(path_of_test_list(folder), "list of test images")
    return {line.strip() for line in text.splitlines()} - {""}


def read_intrinsics(root: Path) -> dict[str, Camera]:
    """Read the cameras c0 and c1.

    Raises:
        InputError: the file is missing or wrong, or has other cameras.
    """
    cameras = read_cameras(root / INTRINSICS)
    if set(cameras) != set(CAMERAS):
        raise InputError(f"{root / INTRINSICS}: expected cameras c0 and c1, got {sorted(cameras)}")
    return cameras


def condition(name: str) -> str:
    """Return day and weather of an image from the timestamp in its name.

    Raises:
        InputError: the name does not have the form of this data set.
    """
    day = ImageName.parse(name).day.isoformat()
    return f"{day} {_DAYS[day]}" if day in _DAYS else day


def slice_folders(path: Path) -> list[Path]:
    """Return the folders of all slices, sorted by number; the path itself if it is a slice."""
    root = path.resolve()
    if _SLICE.fullmatch(root.name):
        return [root]
    numbered = {
        int(match.group(1)): folder
        for folder in root.glob("slice*")
        if folder.is_dir() and (match := _SLICE.fullmatch(folder.name))
    }
    return [numbered[number] for number in sorted(numbered)]


def read_references(poses: Path) -> dict[str, Pose]:
    """Read the public query poses in the folder ``camera-poses`` of a slice, by image.

    Raises:
        InputError: a file is wrong, or two files have a pose of one image.
    """
    references: dict[str, Pose] = {}
    for file in list_files(poses, (".txt",)) if poses.is_dir() else []:
        for name, pose in read_poses(file, centres=True).items():
            if name in references:
                raise InputError(f"{file}: {name} has a pose in another file already: remove one")
            references[name] = pose
    return references


def _open_slice(folder: Path, cameras: dict[str, Camera]) -> Dataset | None:
    """Open one slice, or return None if none of its query poses is public."""
    pose_folder = folder / "camera-poses"
    references = read_references(pose_folder)
    if not references:
        return None
    for name in references:
        if not (folder / "query" / name).is_file():
            raise InputError(
                f"{folder / 'query' / name} does not exist, but {pose_folder} has its pose: add "
                "the image, or remove the pose"
            )
    queries = tuple(
        BenchmarkQuery(**vars(_query(folder, name, cameras)), reference=pose)
        for name, pose in sorted(references.items())
    )
    return _build(Dataset, folder, queries)


def _query(folder: Path, name: str, cameras: Mapping[str, Camera]) -> TaskQuery:
    """Return a query image of a slice."""
    return TaskQuery(
        name=name,
        condition=condition(name),
        group=f"{folder.name} {condition(name)}",
        camera=cameras[ImageName.parse(name).camera],
        image=folder / "query" / name,
        prior=None,
    )


def _build(kind: type[AnyTask], folder: Path, queries: tuple[TaskQuery, ...]) -> AnyTask:
    """Return a slice with some of its query images, as a data set with or without poses."""
    sparse_map = read_model(folder / "sparse")
    number = int(folder.name.removeprefix("slice"))
    return kind(
        name=f"cmu-{surroundings(number)}-slice{number}",
        track=_track(folder.parent),
        parts=parts_of(folder / "sparse", folder / "database", sparse_map.names, queries),
        map_conditions=tuple(sorted({condition(name) for name in sparse_map.images})),
        model=folder / "sparse",
        load_map=lambda: sparse_map,
        images=folder / "database",
        queries=queries,
    )


def _track(root: Path) -> str:
    """Return the track: simulated photographs, or those of the data set itself."""
    simulated = read_text(root / INTRINSICS, "cameras").startswith(SIMULATED_HEADER)
    return SIMULATED_TRACK if simulated else TRACK
