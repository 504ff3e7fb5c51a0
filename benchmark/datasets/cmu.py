"""Reader of Extended CMU Seasons: the slices whose query poses are public.

The reader takes the download as it is. In some points it differs from its README and from public
loaders: pose files hold the camera's centre, not a translation; the name of each image states its
camera, c0 or c1; pose files may be empty; images are distorted, although an example calls them
"rect"; the reference traversal is that of April 21, 2011, as its timestamps show.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.datasets.identity import parts_of
from objconnect.scene.errors import InputError
from objconnect.scene.exports.cmu_names import CAMERAS, SIMULATED, ImageName, surroundings
from objconnect.scene.flights.textfiles import read_cameras, read_poses
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.storage.files import read_text
from objconnect.scene.storage.listing import list_files

TRACK: Final = "cmu"
SIMULATED_TRACK: Final = "cmu-sim"

_INTRINSICS: Final = "intrinsics.txt"
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
    root = path.resolve()
    if _SLICE.fullmatch(root.name):
        root = root.parent
    return (root / _INTRINSICS).is_file() and bool(_slices(root))


def open_cmu(path: Path) -> list[Dataset]:
    """Open every slice that carries public query poses, or one slice.

    Raises:
        InputError: a file is missing or wrong, a name is not one of this data set, or no slice has
            a public query pose.
    """
    folders, cameras = _find(path)
    datasets = [d for folder in folders if (d := _open_slice(folder, cameras)) is not None]
    if not datasets:
        raise InputError(f"{path} has no public query pose in any camera-poses folder")
    return datasets


class CmuReader:
    """Reads Extended CMU Seasons; see ``benchmark.datasets.open.Reader``."""

    name = "cmu"
    holds = f"{_INTRINSICS} and slice folders (Extended CMU Seasons)"

    def is_one(self, path: Path) -> bool:
        """Return whether a path is the folder of the data set, or of one slice of it."""
        return path.is_dir() and is_cmu(path)

    def open(self, path: Path) -> list[Dataset]:
        """Open the slices; ``open_cmu`` says which errors are raised."""
        return open_cmu(path)


READER: Final = CmuReader()


@dataclass(frozen=True)
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


def open_slices(path: Path) -> list[Slice]:
    """Find every slice with query images, or open the one slice that a path names.

    Raises:
        InputError: the path is not this data set, an image's name is not one of it, or there is no
            query image.
    """
    if not is_cmu(path):
        raise InputError(f"{path} is not Extended CMU Seasons, nor a slice of it")
    folders, cameras = _find(path)
    slices = []
    for folder in folders:
        photographs = folder / "query"
        images = list_files(photographs, (".jpg",)) if photographs.is_dir() else []
        names = tuple(image.name for image in images)
        for name in names:
            ImageName.parse(name)
        if names:
            slices.append(Slice(folder, names, cameras))
    if not slices:
        raise InputError(f"{path} holds no query image")
    return slices


def _find(path: Path) -> tuple[list[Path], dict[str, Camera]]:
    """Return the folders of the slices at a path, and the two cameras."""
    root = path.resolve()
    chosen = _slices(root)
    if _SLICE.fullmatch(root.name):
        chosen, root = [root], root.parent
    cameras = read_cameras(root / _INTRINSICS)
    if set(cameras) != set(CAMERAS):
        raise InputError(f"{root / _INTRINSICS}: expected cameras c0 and c1, got {sorted(cameras)}")
    return chosen, cameras


def condition(name: str) -> str:
    """Return day and weather of an image from the timestamp in its name.

    Raises:
        InputError: the name is not one of this data set.
    """
    day = ImageName.parse(name).day.isoformat()
    return f"{day} {_DAYS[day]}" if day in _DAYS else day


def _slices(root: Path) -> list[Path]:
    """Return the slice folders, sorted by number."""
    numbered = {
        int(match.group(1)): folder
        for folder in root.glob("slice*")
        if folder.is_dir() and (match := _SLICE.fullmatch(folder.name))
    }
    return [numbered[number] for number in sorted(numbered)]


def _open_slice(folder: Path, cameras: dict[str, Camera]) -> Dataset | None:
    """Open one slice, or return None when none of its query poses is public."""
    references: dict[str, Pose] = {}
    listed = folder / "camera-poses"
    for file in list_files(listed, (".txt",)) if listed.is_dir() else []:
        for name, pose in read_poses(file, centres=True).items():
            if name in references:
                raise InputError(f"{file}: {name} has a pose in another file already")
            references[name] = pose
    if not references:
        return None
    for name in references:
        if not (folder / "query" / name).is_file():
            raise InputError(f"{folder / 'query' / name} does not exist, but {listed} has its pose")
    sparse_map = read_model(folder / "sparse")
    queries = tuple(
        BenchmarkQuery(
            name=name,
            condition=condition(name),
            group=f"{folder.name} {condition(name)}",
            camera=cameras[ImageName.parse(name).camera],
            image=folder / "query" / name,
            prior=None,
            reference=pose,
        )
        for name, pose in sorted(references.items())
    )
    number = int(folder.name.removeprefix("slice"))
    return Dataset(
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
    simulated = read_text(root / _INTRINSICS, "cameras").startswith(SIMULATED)
    return SIMULATED_TRACK if simulated else TRACK
