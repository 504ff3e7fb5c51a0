"""Coordinate reference systems: conversion to and from WGS84.

Only this module imports pyproj, which the extra ``[geo]`` installs.
"""

from __future__ import annotations

import warnings
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.runtime.extras import import_extra

# Heights above the geoid EGM96, which autopilots and GPS receivers call sea level.
_SEA_LEVEL = "EPSG:4326+5773"
# WGS84 with ellipsoidal heights, the system of ``Geodetic``.
_WGS84 = "EPSG:4979"
# Tolerated distance from a system's area of use, degrees.
_AREA_MARGIN_DEG = 3.0
# Error of a conversion to WGS84 above which the user is warned, metres. Conversions from current
# systems have 1 to 4 m; those from systems of the last century 8 to 50 m without PROJ's grids.
_MAX_ERROR_M = 5.0
# Arm of the cross that measures the scale of a system, metres.
_CROSS_M = 10.0
# Longer descriptions of a system are not repeated in messages (characters).
_MAX_LABEL_LENGTH = 60


class Projection:
    """Conversion between WGS84 and one coordinate reference system.

    In a two-dimensional system heights stay metres above the ellipsoid. Coordinates are in the
    order east, north (longitude, latitude), independent of the system's authority. PROJ's ballpark
    conversions, which ignore a change of datum or of the height reference, are not used.
    """

    def __init__(self, crs: str, *, horizontal: bool = False, metric_heights: bool = False) -> None:
        """Look up a system.

        Args:
            crs: ``EPSG:n``, or another description that PROJ reads, such as WKT.
            horizontal: ignore the system's heights.
            metric_heights: use metres for heights, whatever the system's unit.

        Raises:
            InputError: pyproj is not installed, it knows no such system, the system has no
                horizontal coordinates, its heights point down, or PROJ has no exact conversion,
                for example because a grid is not installed.
        """
        pyproj = import_extra("pyproj", "geo", "a coordinate reference system")
        label = for_terminal(crs) if len(crs) <= _MAX_LABEL_LENGTH else "the description"
        try:
            self._crs: Any = pyproj.CRS.from_user_input(crs)
        except pyproj.exceptions.ProjError:
            raise InputError(
                f"{label} is not a coordinate reference system that PROJ knows: give "
                "EPSG:n, such as EPSG:32632"
            ) from None
        if horizontal:
            self._crs = _drop_heights(self._crs)
        if not (self._crs.is_projected or self._crs.is_geographic):
            raise InputError(
                f"{label} ({self.name}) has no eastings and northings: give a "
                "projected or geographic system, such as EPSG:32632"
            )
        if any(axis.direction == "down" for axis in self._crs.axis_info):
            raise InputError(
                f"heights in {self.name} point down: give a system with heights that point up"
            )
        self._height_scale = (self.height_unit_m or 1.0) if metric_heights else 1.0
        try:
            self._from_wgs84 = _transformer(pyproj, _WGS84, self._crs)
            self._to_wgs84 = _transformer(pyproj, self._crs, _WGS84)
        except pyproj.exceptions.ProjError:
            raise InputError(self._describe_failure(pyproj)) from None

    @property
    def name(self) -> str:
        """Return the name of the system, such as ``WGS 84 / UTM zone 32N``."""
        return str(self._crs.name)

    @property
    def wkt(self) -> str:
        """Return the system as WKT."""
        return str(self._crs.to_wkt())

    @property
    def height_reference(self) -> str:
        """Return the height reference: the name of the vertical system, or "ellipsoid"."""
        vertical = self._crs.sub_crs_list[1:]
        return str(vertical[0].name) if vertical else "ellipsoid"

    @property
    def has_heights(self) -> bool:
        """Return whether the system defines heights."""
        return len(self._crs.axis_info) > 2

    @property
    def horizontal_units(self) -> tuple[str, ...]:
        """Return the units of the two horizontal axes, such as ``metre``."""
        return tuple(str(axis.unit_name) for axis in self._crs.axis_info[:2])

    @property
    def is_geographic(self) -> bool:
        """Return whether coordinates are longitude and latitude in degrees."""
        return bool(self._crs.is_geographic)

    @property
    def is_metric(self) -> bool:
        """Return whether the system is projected and all its coordinates are metres."""
        horizontal = all(axis.unit_conversion_factor == 1 for axis in self._crs.axis_info[:2])
        vertical = (self.height_unit_m or 1.0) == self._height_scale
        return bool(self._crs.is_projected) and horizontal and vertical

    @property
    def height_unit_m(self) -> float | None:
        """Return the length of the unit of heights, metres; None if the system has no heights."""
        units = [axis.unit_conversion_factor for axis in self._crs.axis_info[2:]]
        return float(units[0]) if units else None

    def scale_at(self, place: Geodetic) -> tuple[float, float]:
        """Return the scale factors along the system's east and north at a position.

        A scale factor is the number of the system's units per metre on the ground. It is close to 1
        in survey grids, and 1 / cos(latitude) in Web Mercator.

        Raises:
            InputError: the place lies outside the system's range.
        """
        ends = np.array([[_CROSS_M, 0, 0], [-_CROSS_M, 0, 0], [0, _CROSS_M, 0], [0, -_CROSS_M, 0]])
        xy = np.array([self.from_geodetic(geodetic_from_enu(end, place))[:2] for end in ends])
        units = np.stack([xy[0] - xy[1], xy[2] - xy[3]], -1) / (2 * _CROSS_M)
        if not np.isfinite(units).all() or not np.linalg.det(units):
            where = f"latitude {place.latitude:g}, longitude {place.longitude:g}"
            raise InputError(f"{self.name} does not cover {where}: give a system that does")
        metres = np.linalg.norm(np.linalg.inv(units), axis=0)
        return float(1 / metres[0]), float(1 / metres[1])

    def doubt_at(self, place: Geodetic) -> str:
        """Return a warning if the conversion at a place may be off by over 5 m, else no text."""
        pyproj = import_extra("pyproj", "geo", "a coordinate reference system")
        self.from_geodetic(place)
        try:
            operation = self._from_wgs84.get_last_used_operation()
        except pyproj.exceptions.ProjError:  # the system does not reach there
            return ""
        if operation.accuracy <= _MAX_ERROR_M:
            return ""
        grid = _missing_grid(pyproj, self._crs)
        remedy = ": PROJ's grids, which projsync installs, improve this" if grid else ""
        accuracy_m = operation.accuracy
        return f"positions in {self.name} are accurate to {accuracy_m:g} m on earth{remedy}"

    def _describe_failure(self, pyproj: Any) -> str:
        """Return why there is no exact conversion, and what to do."""
        if not self._crs.axis_info[2:]:
            return (
                f"PROJ has only a ballpark conversion between {self.name} and WGS 84, which "
                "ignores the change of datum: give the EPSG code of a system whose datum PROJ "
                "knows, such as EPSG:25832"
            )
        if grid := _missing_grid(pyproj, self._crs):
            return (
                f"heights in {self.name} need the grid {grid}, which is not installed: run "
                f"'projsync --file {grid}', or give the horizontal system alone"
            )
        return (
            f"heights in {self.name} cannot be converted: PROJ has only a ballpark conversion to "
            "the ellipsoid: give the horizontal system alone"
        )

    def reaches(self, place: Geodetic) -> bool:
        """Return whether a place lies in the area of use, or within 3 degrees of it."""
        area = _area_of(self._crs)
        if area is not None:
            east = (place.longitude - area.west) % 360
            width = (area.east - area.west) % 360 or 360
            if min(max(0, east - width), 360 - east) > _AREA_MARGIN_DEG:
                return False
            if not area.south - _AREA_MARGIN_DEG <= place.latitude <= area.north + _AREA_MARGIN_DEG:
                return False
        return bool(np.isfinite(self.from_geodetic(place)).all())

    def from_geodetic(self, place: Geodetic) -> NDArray[np.float64]:
        """Convert a place to east, north and height, (3,) in the system's units.

        With ``metric_heights`` the height is in metres.
        """
        x, y, h = self._from_wgs84.transform(place.longitude, place.latitude, place.altitude)
        return np.array([x, y, h * self._height_scale])

    def from_geodetics(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert latitudes, longitudes and altitudes (N, 3) to (N, 3), as ``from_geodetic``."""
        latitude, longitude, altitude = places.T
        x, y, h = self._from_wgs84.transform(longitude, latitude, altitude)
        return np.stack([x, y, h * self._height_scale], -1)

    def to_geodetic(self, coordinates: NDArray[np.float64]) -> Geodetic:
        """Convert east, north and height, (3,) in the units of ``from_geodetic``, to a place.

        Raises:
            InputError: the coordinates are outside the system's range.
        """
        x, y, h = coordinates
        longitude, latitude, altitude = self._to_wgs84.transform(x, y, h / self._height_scale)
        if not np.isfinite([longitude, latitude, altitude]).all():
            numbers = ", ".join(f"{value:g}" for value in coordinates)
            raise InputError(f"{numbers} is not a position in {self.name}")
        return Geodetic(latitude, longitude, altitude)


def geoid_undulation(place: Geodetic) -> float | None:
    """Return the height of the geoid (EGM96) above the ellipsoid at a place, metres.

    It is None if pyproj or its grid ``us_nga_egm96_15.tif`` is not installed. A process that was
    running while the grid was installed does not see it.
    """
    try:
        pyproj = import_extra("pyproj", "geo", "a height above sea level")
    except InputError:
        return None
    sea_level = _sea_level(pyproj.datadir.get_data_dir())
    if sea_level is None:
        return None
    undulation = place.altitude - float(sea_level.from_geodetic(place)[2])
    return undulation if np.isfinite(undulation) else None


@lru_cache(maxsize=4)
def _sea_level(folders: str) -> Projection | None:
    """Return the system of heights above sea level, or None if its grid is not installed.

    The result is cached, because every photograph of a flight needs it, and PROJ takes 0.1 s to
    find that there is no grid.

    Args:
        folders: where PROJ searches for grids.
    """
    try:
        return Projection(_SEA_LEVEL)
    except InputError:
        return None


def _transformer(pyproj: Any, start: Any, end: Any) -> Any:
    return pyproj.Transformer.from_crs(start, end, always_xy=True, allow_ballpark=False)


def _area_of(crs: Any) -> Any:
    """Return the area of use, looked up by EPSG code if WKT lacks it; None if unknown."""
    if crs.area_of_use is not None:
        return crs.area_of_use
    horizontal = _drop_heights(crs)
    code = horizontal.to_epsg(min_confidence=100)
    return horizontal.area_of_use if code is None else type(crs).from_epsg(code).area_of_use


def _drop_heights(crs: Any) -> Any:
    """Return the horizontal part of a system."""
    if crs.is_compound:
        return crs.sub_crs_list[0].to_2d()
    return crs.to_2d() if len(crs.axis_info) > 2 else crs


def _missing_grid(pyproj: Any, crs: Any) -> str | None:
    """Return the grid that the best conversion to a system lacks."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pyproj warns of the missing grid in many lines
        group = pyproj.transformer.TransformerGroup(_WGS84, crs, always_xy=True)
    for operation in group.unavailable_operations:
        lacking = [grid for grid in operation.grids if not grid.available]
        if lacking:
            return str(lacking[0].short_name)
    return None
