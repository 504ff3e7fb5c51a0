"""Reader of AerialExtreMatch-Localization: drone photographs, and orthophotos of two qualities.

The layout is that of the publisher's data set card (hf.co/datasets/Xecades/
AerialExtreMatch-Localization) and of the code of its benchmark (github.com/Xecades/
AerialExtreMatch). No copy of the data set itself has been read.

Poses are quaternions (w, x, y, z) and translations from the coordinates of the surface model to the
camera: metres east, north and height of its reference system. The map of a quality is made by
``objconnect map --ortho`` in the folder ``map`` beside the rasters.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import torch

from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.datasets.flight import TRACK
from benchmark.datasets.identity import parts_of
from objconnect.ingestion.virtual.command import read_recorded_heights
from objconnect.scene.bundle.scene import Scene, is_scene
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import read_cameras, read_poses
from objconnect.scene.geo.local_coordinates import world_pose
from objconnect.scene.geo.rasters import Raster
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Prior
from objconnect.scene.storage.listing import PHOTOGRAPHS, list_files
from objconnect.scene.storage.names import name_some

QUALITIES: Final = ("HQref", "LQref")
"""Folders of the orthophotos and surface models."""

_POSES: Final = "gt_pose.txt"
_PRIORS: Final = "pose.txt"
_CAMERAS: Final = "intrinsic.txt"
_PHOTOGRAPHS: Final = "rgb"
_MAP: Final = "map"
# Largest error of a camera centre (m) from the rounding of its quaternion. The error grows with the
# coordinates.
_MAX_ROUNDING_M: Final = 0.01


class AerialExtreMatchReader:
    """Reads AerialExtreMatch-Localization; see ``benchmark.datasets.open.Reader``."""

    name = "aerialextrematch"
    holds = f"{_POSES} and {_CAMERAS} (AerialExtreMatch-Localization)"

    def recognizes(self, path: Path) -> bool:
        """Return whether a folder looks like the data set, complete or not."""
        return (path / _POSES).is_file() and (path / _CAMERAS).is_file()

    def open(self, path: Path) -> list[Dataset]:
        """Open the data set once for each quality that has a map.

        Raises:
            InputError: no quality has a map, a file is missing or wrong, a query has no camera or
                no photograph, a photograph with a camera has no pose, or a quaternion is rounded
                too coarsely for the coordinates.
        """
        maps = [path / quality / _MAP for quality in QUALITIES]
        found = [each for each in maps if is_scene(each)]
        if not found:
            raise InputError(
                f"{path} has no map yet: run 'objconnect map --ortho {path}/LQref/DOM.tif --dsm "
                f"{path}/LQref/DSM.tif --out {path}/LQref/{_MAP}', or the same for HQref"
            )
        return [_open_quality(path, Scene.open(each)) for each in found]


READER: Final = AerialExtreMatchReader()


def _open_quality(path: Path, scene: Scene) -> Dataset:
    """Open the queries with the map of one quality."""
    references = _read_world_poses(path / _POSES, scene)
    has_priors = (path / _PRIORS).exists()
    priors = _read_world_poses(path / _PRIORS, scene) if has_priors else {}
    photographs = _find_photographs(path / _PHOTOGRAPHS)
    cameras = {Path(name).stem: camera for name, camera in read_cameras(path / _CAMERAS).items()}
    for file, table in ((_CAMERAS, cameras), (_PHOTOGRAPHS, photographs)):
        for name in references:
            if name not in table:
                raise InputError(
                    f"{path / file} has no {name}, but {path / _POSES} has its pose: add it, or "
                    "remove the pose"
                )
    if not references:
        raise InputError(f"{path / _POSES} holds no pose: download the file again")
    # A file that was cut at the end of a line looks whole.
    if missing := [name for name in photographs if name in cameras and name not in references]:
        raise InputError(
            f"{path / _POSES} has no pose of {name_some(missing)}, but {_CAMERAS} and "
            f"{_PHOTOGRAPHS} have {'it' if len(missing) == 1 else 'them'}: download the file "
            f"again, or remove the lines of {_CAMERAS}"
        )
    quality = scene.path.resolve().parent.name
    queries = tuple(
        BenchmarkQuery(
            name=photographs[name].name,
            condition="drone",
            group="drone",
            camera=cameras[name],
            image=photographs[name],
            prior=_prior_of(priors[name]) if name in priors else None,
            reference=reference,
        )
        for name, reference in references.items()
    )
    sparse_map = scene.sparse_map()
    return Dataset(
        name=f"aerialextrematch-{quality}",
        track=TRACK,
        parts=parts_of(scene.map_path, scene.images_root, sparse_map.names, queries),
        map_conditions=("orthophoto",),
        model=scene.map_path,
        load_map=lambda: sparse_map,
        images=scene.images_root,
        queries=queries,
    )


def _read_world_poses(path: Path, scene: Scene) -> dict[str, Pose]:
    """Read poses in the coordinates of the surface model; return them in the map's world frame.

    Returns:
        cam_from_world by name of the photograph without its suffix.
    """
    heights = read_recorded_heights(scene)
    projection = Raster.open(scene.path.parent / heights.file, "surface model").grid.projection
    undulation = torch.tensor([0.0, 0.0, heights.undulation_m], dtype=torch.float64)
    poses: dict[str, Pose] = {}
    for name, pose in read_poses(path, max_rounding_m=_MAX_ROUNDING_M).items():
        stem = Path(name).stem
        if stem in poses:
            raise InputError(f"{path} has two poses of {stem}: remove one of the lines")
        above_ellipsoid = Pose(pose.rotation, pose.translation - pose.rotation @ undulation)
        try:
            poses[stem] = world_pose(projection, scene.manifest.origin, above_ellipsoid)
        except InputError as error:
            raise InputError(f"{path}: {name}: {error}") from None
    return poses


def _find_photographs(folder: Path) -> dict[str, Path]:
    """Return the photographs of a folder by name without suffix."""
    photographs: dict[str, Path] = {}
    for file in list_files(folder, PHOTOGRAPHS):
        if file.stem in photographs:
            raise InputError(f"{folder} holds {file.name} twice, with two suffixes: remove one")
        photographs[file.stem] = file
    return photographs


def _prior_of(pose: Pose) -> Prior:
    """Return a measured pose as a prior; the data set does not state its accuracy."""
    return Prior(pose.centre().numpy(), cam_from_world_rotation=pose.rotation.numpy())
