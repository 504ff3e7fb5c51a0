"""Photographs that ``localize`` reads, as queries with their camera and their prior."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmark.datasets.textfiles import read_priors, require_same_case
from ingest.attitude import gimbal_pose
from scene.errors import InputError
from scene.geometry.camera import Camera
from scene.geometry.geodesy import Geodetic, enu_from_geodetic
from scene.localizer import Prior, Query
from scene.maps.sparse_map import SparseMap
from scene.storage.images import read_exif, read_rgb

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Place:
    """A map, its photographs, and the position of its origin on earth (None if unknown)."""

    sparse_map: SparseMap
    images: Path
    origin: Geodetic | None


@dataclass(frozen=True)
class PhotographReader:
    """Reads photographs as queries, with their camera and their prior."""

    place: Place
    camera: Camera | None
    priors: Mapping[str, Prior] | None
    gps_sigma_m: float
    gimbal_sigma_deg: float

    def __call__(self, name: str, path: Path) -> Query:
        """Read a photograph as a query.

        Raises:
            InputError: the photograph cannot be read, or has no camera.
        """
        image = read_rgb(path, self.camera)
        camera = self.camera or self._camera(path, image.shape[1], image.shape[0])
        prior = self._exif_prior(path) if self.priors is None else self.priors.get(name)
        return Query(name, image, camera, prior)

    def without_gimbal(self, query: Query) -> Query | None:
        """Return the query without the attitude of its gimbal; None where it has none.

        The attitude is wrong for a picture that was rotated after it was taken.
        """
        prior = query.prior
        if prior is None or prior.cam_from_world_rotation is None or self.priors is not None:
            return None
        return replace(
            query, prior=replace(prior, cam_from_world_rotation=None, attitude_sigma_deg=None)
        )

    def _camera(self, path: Path, width: int, height: int) -> Camera:
        """Return the map's camera of the photograph's size."""
        cameras = {image.camera for image in self.place.sparse_map.images.values()}
        fitting = [camera for camera in cameras if (camera.width, camera.height) == (width, height)]
        if len(fitting) != 1:
            raise InputError(
                f"{path} is {width} x {height} pixels and the map has {len(fitting)} cameras of "
                "that size: give its calibration with --camera 'MODEL width height params...'"
            )
        return fitting[0]

    def _exif_prior(self, path: Path) -> Prior | None:
        """Return the position in EXIF, with the attitude of the gimbal in XMP."""
        exif, origin = read_exif(path), self.place.origin
        if exif.position is None or origin is None:
            return None
        prior = Prior(enu_from_geodetic(exif.position, origin), np.full(3, self.gps_sigma_m))
        if exif.gimbal is None:
            return prior
        return replace(
            prior,
            cam_from_world_rotation=gimbal_pose(*exif.gimbal).rotation.numpy(),
            attitude_sigma_deg=self.gimbal_sigma_deg,
        )


def priors_of(path: Path | None, photographs: Mapping[str, Path]) -> dict[str, Prior] | None:
    """Read the priors of a table; None without a table."""
    if path is None:
        return None
    priors = read_priors(path)
    require_same_case(path, priors, photographs)
    without = [name for name in photographs if name not in priors]
    if len(without) == len(photographs):
        raise InputError(f"{path} has none of the photographs, such as {without[0]!r}")
    if without:
        log.warning("%s lacks %d of %d photographs", path, len(without), len(photographs))
    return priors
