"""Poses of photographs from another program, which replace structure from motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.adjustment import AdjustedModel
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
from objconnect.scene.imports.poses import CoordinateFrame
from objconnect.scene.maps.photographs import Photograph, PosedImage
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.atomic import atomic_folder
from objconnect.scene.storage.digests import sha256

Array = NDArray[np.float64]

_IDENTITY = np.eye(4)[:3]


@dataclass(frozen=True)
class ImportedPoses:
    """Poses from another program, and the origin of their world.

    Attributes:
        images: photographs with pose and camera (at the size of the scene's photographs), by name.
        origin: geodetic coordinates of the world's origin; None where GPS georegisters the model.
    """

    images: Mapping[str, PosedImage]
    origin: Geodetic | None

    @property
    def sha256(self) -> str:
        """Return a digest of poses, cameras and origin."""
        pieces = ((f"{name} {i.camera}", i.cam_from_world) for name, i in self.images.items())
        return sha256(repr(self.origin), *(piece for pair in pieces for piece in pair))

    @property
    def centres(self) -> dict[str, Array]:
        """Return the camera centres (3,) by name, in the world of the poses."""
        poses = {name: image.cam_from_world for name, image in self.images.items()}
        return {name: -pose[:3, :3].T @ pose[:3, 3] for name, pose in poses.items()}

    def photographs(self) -> list[Photograph]:
        """Return the photographs with calibrated cameras, for matching."""
        return [
            Photograph(
                image.name, image.camera, str(image.camera), calibrated=True, focal_known=True
            )
            for image in self.images.values()
        ]


def read_imported(
    path: Path,
    flight: Flight,
    size: int,
    calibration: Camera | None,
    frame: CoordinateFrame | None = None,
) -> tuple[Flight, ImportedPoses]:
    """Read the poses of photographs from another program's file.

    Args:
        path: file or folder, see ``objconnect.scene.imports``.
        flight: the photographs.
        size: longest side of the photographs in the scene, pixels.
        calibration: camera of all photographs instead of those of the file.
        frame: frame of the poses, if the file does not state it; see ``read_foreign``.

    Returns:
        The flight without photographs that have no pose, and the poses.

    Raises:
        InputError: the file cannot be read, has no attitudes, no cameras or none of the
            photographs, or has a camera of another aspect ratio.
    """
    foreign = read_foreign(path, frame)
    if not foreign.has_attitude:
        raise InputError(f"{path} has positions without attitudes: give it as --gps")
    matched = match_files([image.file for image in flight.images], foreign.names, path)
    if not matched:
        raise InputError(
            f"{path} names none of the photographs: its first name is {foreign.names[0]!r}, the "
            f"first photograph is {flight.images[0].file!r}"
        )
    row = {name: k for k, name in enumerate(foreign.names)}
    images = {}
    for image in flight.images:
        if image.file not in matched:
            continue
        k = row[matched[image.file]]
        camera = calibration or foreign.cameras[k]
        if camera is None:
            raise InputError(f"{path} has no camera of {image.file}: give --camera")
        sized = scale_camera(camera, size, image)
        images[image.name] = PosedImage(image.name, sized, foreign.cam_from_world[k])
    left_out = {i.file: f"no pose in {path.name}" for i in flight.images if i.file not in matched}
    return flight.leave_out(left_out), ImportedPoses(images, foreign.origin)


def triangulate_imported(
    imported: ImportedPoses,
    names: Sequence[str],
    fixes: Mapping[str, Array],
    root: Path,
    database: Path,
) -> AdjustedModel:
    """Triangulate photographs with imported poses, and georegister them if they have no origin.

    Args:
        imported: the poses, which do not change relative to each other.
        names: names of the photographs.
        fixes: measured positions (3,) by name, world metres.
        root: folder that the names are relative to.
        database: file filled by ``match_photographs``; the model is written beside it.

    Raises:
        InputError: no point could be triangulated, or for the reasons of ``georegister``.
    """
    images = [imported.images[name] for name in names]
    lenses, folder = RefinedLenses(()), database.parent / "given"
    with atomic_folder(folder) as partial:
        raw, _ = triangulate_again(root, images, database, partial)
    if imported.origin is not None:
        return AdjustedModel(raw, compare_with_fixes(raw, fixes), lenses, 0.0, {}, folder)
    georegistration = georegister(raw, fixes)
    return AdjustedModel(
        raw.transform(georegistration.world_from_model), georegistration, lenses, 0.0, {}, folder
    )


def compare_with_fixes(model: SparseMap, fixes: Mapping[str, Array]) -> Georegistration:
    """Compare a model that is already in the world with its fixes, without moving it."""
    names = [name for name in model.names if name in fixes]
    residuals = np.array([fixes[n] - model.images[n].centre for n in names]).reshape(-1, 3)
    distance = np.linalg.norm(np.nan_to_num(residuals), axis=1)
    scatter_m = SIGMA_OF_MEDIAN * float(np.median(distance)) if names else 0.0
    good = distance <= max(BLUNDER_SIGMAS * scatter_m, USUAL_ERROR_M)
    sigma = rms_of(residuals[good]) if good.any() else np.full(3, MIN_SIGMA_M)
    blunders = tuple(name for name, ok in zip(names, good, strict=True) if not ok)
    return Georegistration(_IDENTITY, "given", blunders, np.maximum(sigma, MIN_SIGMA_M))
