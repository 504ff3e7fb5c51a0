"""The place that photographs are localized in: a map, its photographs, and where it is on earth."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.localization.pipeline.answers import Geography
from objconnect.localization.pipeline.options import LocalizeOptions
from objconnect.scene.bundle.georeference import Georeference
from objconnect.scene.bundle.scene import Scene, is_scene
from objconnect.scene.errors import InputError
from objconnect.scene.flights.origin import read_origin
from objconnect.scene.geo.crs import geoid_undulation
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic, geodetic_from_enu
from objconnect.scene.localizer import Estimate
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.sparse_map import SparseMap

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Place:
    """A map, its photographs, and its place on earth.

    Attributes:
        sparse_map: the map.
        images: folder of its photographs.
        origin: position of its origin on earth; None if unknown.
        georeference: how exactly that position is known; None if unknown.
    """

    sparse_map: SparseMap
    images: Path
    origin: Geodetic | None
    georeference: Georeference | None = None

    @cached_property
    def cameras(self) -> frozenset[Camera]:
        """Return the cameras of the map's photographs."""
        return frozenset(image.camera for image in self.sparse_map.images.values())

    def locate(
        self, place: Geodetic, origin: Geodetic, sigma: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return a place on earth in the map's world, (3,) metres, and its standard deviations.

        Where the altitude is unknown, the height is that of the map's cameras, and its sigma is
        infinite.
        """
        if not np.isnan(place.altitude):
            return enu_from_geodetic(place, origin), sigma
        position = enu_from_geodetic(place._replace(altitude=origin.altitude), origin)
        position[2] = np.median(self.sparse_map.centres[:, 2])
        return position, np.array([*sigma[:2], np.inf])

    def on_earth(self, estimate: Estimate) -> Geodetic | None:
        """Return the camera's position on earth; None without a pose or an origin."""
        if estimate.cam_from_world is None or self.origin is None:
            return None
        return geodetic_from_enu(estimate.cam_from_world.centre().numpy(), self.origin)


def open_place(path: Path) -> Place:
    """Open a scene with its map, or a flight, to localize photographs in it.

    Raises:
        InputError: the path is neither, or its map is missing, damaged or empty.
    """
    if is_scene(path):
        scene = Scene.open(path)
        manifest = scene.manifest
        images = scene.images_root
        return Place(scene.sparse_map(), images, manifest.origin, manifest.effective_georeference)
    if (path / "sparse" / "map").is_dir():
        return Place(read_model(path / "sparse" / "map"), path / "images", read_origin(path))
    raise InputError(f"{path} is no map: it is neither a scene nor a folder with sparse/map")


def geography_of(place: Place, options: LocalizeOptions) -> Geography:
    """Return what places are said in beside WGS84.

    Raises:
        InputError: the map has no position on earth and something was asked that needs one, or the
            system does not reach there.
    """
    undulation_m, projection = options.undulation_m, options.projection
    asked = [*options.also, *([] if projection is None else [projection.name])]
    if place.origin is None:
        if asked:
            raise InputError(
                f"{asked[0]} cannot be written, for the map has no position on earth: give a "
                "flight its origin.json (lat, lon, alt)"
            )
        return Geography(undulation_m)
    if projection is not None and not projection.reaches(place.origin):
        raise InputError(f"the map lies outside {projection.name}: give the system of its zone")
    if projection is not None and (doubt := projection.doubt_at(place.origin)):
        log.warning("%s", doubt)
    if undulation_m is None:
        undulation_m = geoid_undulation(place.origin)
    return Geography(undulation_m, projection, place.georeference)
