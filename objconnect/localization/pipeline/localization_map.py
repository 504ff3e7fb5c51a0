"""The localization map: a sparse map, its photographs and its position on earth."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

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
from objconnect.scene.quantities.altitudes import LARGEST_DIFFERENCE_M
from objconnect.scene.quantities.coordinate_order import REACH_M
from objconnect.scene.quantities.reading import Reading, known, unknown
from objconnect.scene.storage.files import require_folder

log = logging.getLogger(__name__)

# No drone flies higher above the ground of its map (m).
_HIGHEST_FLIGHT_M: Final = 10_000.0
# Percentage of a map's points that are below its lowest ground, as errors of triangulation are.
_BELOW_GROUND: Final = 1.0


@dataclass(frozen=True)
class LocalizationMap:
    """A sparse map, its photographs, and its position on earth.

    Attributes:
        sparse_map: the map.
        images: folder of the photographs.
        origin: position of the map's origin on earth; None if unknown.
        georeference: accuracy of the map's position on earth; None if unknown.
    """

    sparse_map: SparseMap
    images: Path
    origin: Geodetic | None
    georeference: Georeference | None = None

    @cached_property
    def cameras(self) -> frozenset[Camera]:
        """Return the cameras of the map's photographs."""
        return frozenset(image.camera for image in self.sparse_map.images.values())

    @cached_property
    def _lowest_ground(self) -> float:
        """Return the height of the lowest ground in the map's frame, metres."""
        return float(np.percentile(self.sparse_map.xyz[:, 2], _BELOW_GROUND))

    def check_place(self, place: Geodetic, origin: Geodetic) -> Reading[Geodetic]:
        """Return a measured position without what cannot be true of a photograph of this map.

        The position is unknown if it is out of reach of the map. Its altitude is unknown (NaN) if
        no drone flies as high above the map's lowest ground, or if it is farther below this ground
        than altitudes differ whose references are confused.

        Args:
            place: the position; its altitude is NaN if unknown.
            origin: position of the map's origin on earth.
        """
        source = "position"
        level = place._replace(altitude=origin.altitude)
        distance = float(np.linalg.norm(enu_from_geodetic(level, origin)))
        if distance > REACH_M:
            doubt = f"its position is {distance / 1000:.0f} km from the map and is not used"
            return unknown(source, doubt)
        height = place.altitude - origin.altitude - self._lowest_ground
        if height > _HIGHEST_FLIGHT_M or height < -LARGEST_DIFFERENCE_M:
            where = f"{abs(height):.0f} m {'above' if height > 0 else 'below'} the map's ground"
            doubt = f"its altitude is {where} and is not used"
            return known(place._replace(altitude=np.nan), source, doubt)
        return known(place, source)

    def to_map_frame(
        self, place: Geodetic, origin: Geodetic, sigma: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return a geodetic position in the map's frame, (3,) metres, and its standard deviations.

        If the altitude is unknown, the height is the median of the map's cameras with infinite
        sigma.

        Args:
            place: the position; its altitude is NaN if unknown.
            origin: position of the map's origin on earth.
            sigma: (3,) standard deviations to the east, north and up, metres.
        """
        if not np.isnan(place.altitude):
            return enu_from_geodetic(place, origin), sigma
        position = enu_from_geodetic(place._replace(altitude=origin.altitude), origin)
        position[2] = np.median(self.sparse_map.centres[:, 2])
        return position, np.array([*sigma[:2], np.inf])

    def locate_on_earth(self, estimate: Estimate) -> Geodetic | None:
        """Return the camera's position on earth; None without a pose or an origin."""
        if estimate.cam_from_world is None or self.origin is None:
            return None
        return geodetic_from_enu(estimate.cam_from_world.centre().numpy(), self.origin)


def open_map(path: Path) -> LocalizationMap:
    """Open the map of a scene (a folder with ``scene.json``) or of a folder with ``sparse/map``.

    Raises:
        InputError: the path does not exist or is neither of these folders, or its map is missing,
            damaged or empty.
    """
    if is_scene(path):
        scene = Scene.open(path)
        manifest = scene.manifest
        images = scene.images_root
        return LocalizationMap(
            scene.sparse_map(), images, manifest.origin, manifest.effective_georeference
        )
    if (path / "sparse" / "map").is_dir():
        return LocalizationMap(
            read_model(path / "sparse" / "map"), path / "images", read_origin(path)
        )
    require_folder(path, "map folder")
    raise InputError(
        f"{path} is not a map: give a scene (a folder with scene.json) or a folder with sparse/map"
    )


def geography_of(localization_map: LocalizationMap, options: LocalizeOptions) -> Geography:
    """Return the coordinates to write in addition to WGS84, and the map's absolute accuracy.

    Raises:
        InputError: the map has no position on earth and an output needs one, or the map lies
            outside the coordinate reference system.
    """
    undulation_m, projection = options.undulation_m, options.projection
    geographic_outputs = [*options.also, *([] if projection is None else [projection.name])]
    if localization_map.origin is None:
        if geographic_outputs:
            raise InputError(
                f"{geographic_outputs[0]} cannot be written because the map has no position on "
                "earth: add origin.json (lat, lon, alt) to the folder of the map"
            )
        return Geography(undulation_m)
    if projection is not None and not projection.reaches(localization_map.origin):
        raise InputError(f"the map lies outside {projection.name}: give the CRS of the map's zone")
    if projection is not None and (doubt := projection.doubt_at(localization_map.origin)):
        log.warning("%s", doubt)
    if undulation_m is None:
        undulation_m = geoid_undulation(localization_map.origin)
    return Geography(undulation_m, projection, localization_map.georeference)
