"""Coordinate reference systems by their EPSG codes.

This is the one module that imports pyproj, which the extra ``[geo]`` installs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scene.errors import InputError
from scene.geometry.geodesy import Geodetic
from scene.runtime.escaping import for_terminal
from scene.runtime.extras import import_extra

# WGS84 with ellipsoidal heights: what a Geodetic is.
_WGS84 = "EPSG:4979"


class Projection:
    """Conversion between WGS84 and one coordinate reference system.

    Heights are passed through where the system has only two dimensions: they stay metres above the
    ellipsoid. Coordinates are in the order east, north (longitude, latitude), whatever order
    the system's authority has.
    """

    def __init__(self, crs: str) -> None:
        """Look a system up.

        Args:
            crs: ``EPSG:n``, or another description that PROJ reads, such as WKT.

        Raises:
            InputError: pyproj is not installed, or it knows no such system.
        """
        pyproj = import_extra("pyproj", "geo", "a coordinate reference system")
        try:
            self._crs: Any = pyproj.CRS.from_user_input(crs)
            turned = {"always_xy": True}
            self._from = pyproj.Transformer.from_crs(_WGS84, self._crs, **turned)
            self._to = pyproj.Transformer.from_crs(self._crs, _WGS84, **turned)
        except pyproj.exceptions.ProjError:
            raise InputError(
                f"{for_terminal(crs)} is no coordinate reference system that PROJ knows: give "
                "EPSG:n, such as EPSG:32632"
            ) from None

    @property
    def name(self) -> str:
        """Name of the system, such as ``WGS 84 / UTM zone 32N``."""
        return str(self._crs.name)

    @property
    def wkt(self) -> str:
        """The system as WKT, for files of other programs."""
        return str(self._crs.to_wkt())

    def from_geodetic(self, place: Geodetic) -> NDArray[np.float64]:
        """Return east, north and height of a place, (3,) in the system's units."""
        return np.array(self._from.transform(place.longitude, place.latitude, place.altitude))

    def to_geodetic(self, coordinates: NDArray[np.float64]) -> Geodetic:
        """Return the place of east, north and height, (3,) in the system's units.

        Raises:
            InputError: the system does not reach there.
        """
        longitude, latitude, altitude = self._to.transform(*coordinates)
        if not np.isfinite([longitude, latitude, altitude]).all():
            at = ", ".join(f"{value:g}" for value in coordinates)
            raise InputError(f"{at} is no position in {self.name}")
        return Geodetic(latitude, longitude, altitude)
