"""Coordinate reference systems by their EPSG codes.

This is the one module that imports pyproj, which the extra ``[geo]`` installs.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scene.errors import InputError
from scene.geometry.geodesy import Geodetic
from scene.runtime.escaping import for_terminal
from scene.runtime.extras import import_extra

# Heights above the geoid EGM96, which autopilots and GPS receivers call sea level.
_SEA_LEVEL = "EPSG:4326+5773"
# WGS84 with ellipsoidal heights: what a Geodetic is.
_WGS84 = "EPSG:4979"
# How far beyond its area of use a system may be used, degrees.
_BESIDE_DEG = 3.0


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
            InputError: pyproj is not installed, it knows no such system, the system has no
                horizontal coordinates, or the grid of its heights is not installed.
        """
        pyproj = import_extra("pyproj", "geo", "a coordinate reference system")
        try:
            self._crs: Any = pyproj.CRS.from_user_input(crs)
            if not (self._crs.is_projected or self._crs.is_geographic):
                raise InputError(
                    f"{for_terminal(crs)} ({self.name}) has no eastings and northings: give a "
                    "projected or geographic system, such as EPSG:32632"
                )
            if self._crs.is_compound and (grid := _missing_grid(pyproj, self._crs)):
                raise InputError(
                    f"heights in {self.name} need the grid {grid}, which is not installed: run "
                    f"'projsync --file {grid}', or give the horizontal system alone"
                )
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

    @property
    def heights(self) -> str:
        """Name of what heights are above: the vertical part of the system, else the ellipsoid."""
        vertical = self._crs.sub_crs_list[1:]
        return str(vertical[0].name) if vertical else "ellipsoid"

    @property
    def has_heights(self) -> bool:
        """Whether the system states what heights are above and in which unit."""
        return len(self._crs.axis_info) > 2

    @property
    def horizontal_units(self) -> tuple[str, ...]:
        """Names of the units of the two horizontal axes, such as ``metre``."""
        return tuple(str(axis.unit_name) for axis in self._crs.axis_info[:2])

    @property
    def is_geographic(self) -> bool:
        """Whether coordinates are longitude and latitude in degrees."""
        return bool(self._crs.is_geographic)

    @property
    def is_metric(self) -> bool:
        """Return whether all coordinates are metres: whether it is a map's grid, not degrees."""
        return bool(self._crs.is_projected) and all(
            axis.unit_name == "metre" for axis in self._crs.axis_info
        )

    def reaches(self, place: Geodetic) -> bool:
        """Return whether a place has coordinates here: within the area of use, or near its border,
        as sites that two zones share."""
        area = self._crs.area_of_use
        if area is not None:
            east = (place.longitude - area.west) % 360
            width = (area.east - area.west) % 360 or 360
            if min(max(0, east - width), 360 - east) > _BESIDE_DEG:
                return False
            if not area.south - _BESIDE_DEG <= place.latitude <= area.north + _BESIDE_DEG:
                return False
        return bool(np.isfinite(self.from_geodetic(place)).all())

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


def geoid_undulation(place: Geodetic) -> float | None:
    """Return the height of the geoid (EGM96) above the ellipsoid at a place, metres.

    It is None where pyproj or its grid ``us_nga_egm96_15.tif`` is not installed.
    """
    try:
        above_sea = Projection(_SEA_LEVEL).from_geodetic(place)[2]
    except InputError:
        return None
    undulation = place.altitude - float(above_sea)
    return undulation if np.isfinite(undulation) else None


def _missing_grid(pyproj: Any, crs: Any) -> str | None:
    """Return the grid that the best conversion to a system lacks; without, heights are wrong."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it says the same in many lines
        group = pyproj.transformer.TransformerGroup(_WGS84, crs, always_xy=True)
    if group.best_available or not group.unavailable_operations:
        return None
    lacking = [grid for grid in group.unavailable_operations[0].grids if not grid.available]
    return str(lacking[0].short_name) if lacking else None
