"""Photographs whose poses another program has found, which replace structure from motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.adjustment import Adjusted
from objconnect.ingestion.georegister import (
    BLUNDER_SIGMAS,
    MIN_SIGMA_M,
    USUAL_ERROR_M,
    Georegistration,
    georegister,
    rms_of,
)
from objconnect.ingestion.photographs import Flight, scale_camera
from objconnect.scene.colmap.structure_from_motion import RefinedLenses
from objconnect.scene.colmap.triangulation import triangulate_again
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.geometry.robust import SIGMA_OF_MEDIAN
from objconnect.scene.imports.formats import read_foreign
from objconnect.scene.imports.names import match_files
from objconnect.scene.imports.poses import Frame
from objconnect.scene.maps.photographs import Photograph, PosedImage
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.atomic import atomic_folder
from objconnect.scene.storage.digests import sha256

Array = NDArray[np.float64]

_IDENTITY = np.eye(4)[:3]


@dataclass(frozen=True)
class Given:
    """Poses that another program has found, and their world.

    Attributes:
        images: photographs with pose and camera (at the size of the scene's photographs), by name.
        origin: place of the world's origin; None where GPS has to place the world.
    """

    images: Mapping[str, PosedImage]
    origin: Geodetic | None

    @property
    def sha256(self) -> str:
        """Return a digest of poses, cameras and origin."""
        each = ((f"{name} {of.camera}", of.cam_from_world) for name, of in self.images.items())
        return sha256(repr(self.origin), *(piece for pieces in each for piece in pieces))

    @property
    def centres(self) -> dict[str, Array]:
        """Return the camera centres (3,) by name, in the world of the poses."""
        poses = {name: image.cam_from_world for name, image in self.images.items()}
        return {name: -pose[:3, :3].T @ pose[:3, 3] for name, pose in poses.items()}

    def photographs(self) -> list[Photograph]:
        """Return the photographs as the matcher takes them."""
        return [
            Photograph(image.name, image.camera, str(image.camera), True, True)
            for image in self.images.values()
        ]


def read_given(
    path: Path,
    flight: Flight,
    size: int,
    calibration: Camera | None,
    frame: Frame | None = None,
) -> tuple[Flight, Given]:
    """Read the poses of photographs from another program's file.

    Args:
        path: file or folder, see ``objconnect.scene.imports``.
        flight: the photographs.
        size: longest side of the photographs in the scene, pixels.
        calibration: camera of all photographs instead of those of the file.
        frame: frame of the poses, where the file leaves it open; see ``read_foreign``.

    Returns:
        The flight without photographs that have no pose, and the poses.

    Raises:
        InputError: the file cannot be read, tells no attitudes or no cameras, means none of the
            photographs, or has a camera of another shape.
    """
    foreign = read_foreign(path, frame)
    if not foreign.has_attitude:
        raise InputError(f"{path} tells positions without attitudes: give it as --gps")
    found = match_files([image.file for image in flight.images], foreign.names, path)
    if not found:
        raise InputError(
            f"{path} has none of the photographs: its first name is {foreign.names[0]!r}, that of "
            f"the first photograph {flight.images[0].file!r}"
        )
    row = {name: k for k, name in enumerate(foreign.names)}
    images = {}
    for image in flight.images:
        if image.file not in found:
            continue
        k = row[found[image.file]]
        camera = calibration or foreign.cameras[k]
        if camera is None:
            raise InputError(f"{path} tells no camera of {image.file}: give --camera")
        sized = scale_camera(camera, size, image)
        images[image.name] = PosedImage(image.name, sized, foreign.cam_from_world[k])
    left = {i.file: f"no pose in {path.name}" for i in flight.images if i.file not in found}
    return flight.without(left), Given(images, foreign.origin)


def triangulate_imported(
    given: Given,
    there: Sequence[str],
    fixes: Mapping[str, Array],
    root: Path,
    database: Path,
) -> Adjusted:
    """Triangulate the matches of posed photographs, and place them by GPS if they need it.

    Args:
        given: the poses, which do not change relative to each other.
        there: names of the photographs.
        fixes: measured positions (3,) by name, world metres.
        root: folder that the names are relative to.
        database: file filled by ``match_photographs``; the model is written beside it.

    Raises:
        InputError: no point could be triangulated, or as ``georegister``.
    """
    images = [given.images[name] for name in there]
    lenses, folder = RefinedLenses(()), database.parent / "given"
    with atomic_folder(folder) as partial:
        raw, _ = triangulate_again(root, images, database, partial)
    if given.origin is not None:
        return Adjusted(raw, keep_imported(raw, fixes), lenses, 0.0, {}, folder)
    placed = georegister(raw, fixes)
    return Adjusted(raw.transform(placed.world_from_model), placed, lenses, 0.0, {}, folder)


def keep_imported(model: SparseMap, fixes: Mapping[str, Array]) -> Georegistration:
    """Return the placement of a model that is in the world, and the fixes that contradict it."""
    names = [name for name in model.names if name in fixes]
    off = np.array([fixes[n] - model.images[n].centre for n in names]).reshape(-1, 3)
    distance = np.linalg.norm(np.nan_to_num(off), axis=1)
    usual = SIGMA_OF_MEDIAN * float(np.median(distance)) if names else 0.0
    good = distance <= max(BLUNDER_SIGMAS * usual, USUAL_ERROR_M)
    sigma = rms_of(off[good]) if good.any() else np.full(3, MIN_SIGMA_M)
    blunders = tuple(name for name, ok in zip(names, good, strict=True) if not ok)
    return Georegistration(_IDENTITY, "given", blunders, np.maximum(sigma, MIN_SIGMA_M))
