"""Tables of priors (approximate camera poses), and their conversion to the map's frame."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic
from objconnect.scene.localizer import Prior
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.quantities.position_columns import CoordinateFrame

log = logging.getLogger(__name__)

# No map is larger: a position farther away is in another frame or has its columns exchanged.
_FARTHEST_FROM_MAP_M: Final = 50_000.0
# The limit grows by this many standard deviations of the position.
_SIGMAS: Final = 5.0


@dataclass(frozen=True)
class StatedPrior:
    """A row of a table of priors.

    Attributes:
        where: file and line of the row.
        frame: frame of the position.
        horizontal: east and north in metres, or latitude and longitude in degrees.
        vertical: up in metres, or altitude in metres above the ellipsoid; None if unknown.
        sigma_m: standard deviation of the position per axis, metres; None if not stated.
        rotation: cam_from_world, (3, 3); None if unknown.
        sigma_deg: standard deviation of the attitude per axis, degrees; None if not stated.
    """

    where: str
    frame: CoordinateFrame
    horizontal: tuple[float, float]
    vertical: float | None
    sigma_m: float | None
    rotation: NDArray[np.float64] | None
    sigma_deg: float | None


@dataclass(frozen=True)
class MapFrame:
    """The location of a map.

    Attributes:
        origin: geodetic position of its origin; None if unknown.
        middle: median of its camera centres, (3,) metres in its frame.
    """

    origin: Geodetic | None
    middle: NDArray[np.float64]

    @staticmethod
    def of(sparse_map: SparseMap, origin: Geodetic | None) -> MapFrame:
        """Return the frame of a map."""
        centres = [image.centre for image in sparse_map.images.values()]
        return MapFrame(origin, np.median(np.stack(centres), axis=0) if centres else np.zeros(3))

    def position_of(self, stated: StatedPrior) -> NDArray[np.float64]:
        """Return the position of a row, (3,) metres in the map's frame.

        A row without a height gets the median height of the map's cameras.

        Raises:
            InputError: the row has latitude and longitude but the map has no position on earth, or
                the position is too far from the map.
        """
        first, second = stated.horizontal
        up = self.middle[2] if stated.vertical is None else stated.vertical
        position = np.array([first, second, up])
        if stated.frame is CoordinateFrame.EARTH:
            if self.origin is None:
                raise InputError(
                    f"{stated.where}: latitude and longitude cannot be used, because the map has "
                    "no position on earth: write e, n, u in metres in the map's frame, or, for the "
                    "map of a flight, add origin.json (lat, lon, alt) to the flight's folder"
                )
            camera_altitude = self.origin.altitude + float(self.middle[2])
            altitude = camera_altitude if stated.vertical is None else stated.vertical
            position = enu_from_geodetic(Geodetic(first, second, altitude), self.origin)
            if stated.vertical is None:
                position[2] = self.middle[2]
        self._require_near(stated, position)
        return position

    def _require_near(self, stated: StatedPrior, position: NDArray[np.float64]) -> None:
        """Refuse a position that is too far from the map, given its sigma."""
        distance_m = float(np.linalg.norm(position - self.middle))
        if distance_m <= _FARTHEST_FROM_MAP_M + _SIGMAS * (stated.sigma_m or 0.0):
            return
        remedy = (
            "check whether lat and lon are exchanged, and whether this is the right map"
            if stated.frame is CoordinateFrame.EARTH
            else "e, n, u are metres in the map's frame, not eastings and northings of a grid"
        )
        raise InputError(
            f"{stated.where}: the position is {distance_m / 1000:.0f} km off the map: {remedy}"
        )


@dataclass(frozen=True)
class AssumedSigmas:
    """Standard deviations for rows of a table of priors that state none.

    Attributes:
        sigma_m: standard deviation of positions per axis, (3,) metres; None if unknown.
        sigma_deg: standard deviation of attitudes, degrees; None if unknown.
        sigma_m_source: source of ``sigma_m``, a phrase for the warning.
        sigma_deg_source: source of ``sigma_deg``, a phrase for the warning.
    """

    sigma_m: NDArray[np.float64] | None = None
    sigma_deg: float | None = None
    sigma_m_source: str = ""
    sigma_deg_source: str = ""


@dataclass(frozen=True)
class PriorTable:
    """The rows of a table of priors by name of the photograph, in the order of the file."""

    path: Path
    rows: Mapping[str, StatedPrior]

    @property
    def states_all_sigmas(self) -> bool:
        """Return whether every row states the sigma of its position."""
        return all(row.sigma_m is not None for row in self.rows.values())

    def positions(self, frame: MapFrame, names: Collection[str]) -> dict[str, NDArray[np.float64]]:
        """Return the positions of photographs whose height is known, (3,) metres each.

        Raises:
            InputError: for the reasons of ``MapFrame.position_of``.
        """
        return {
            name: frame.position_of(row)
            for name, row in self.rows.items()
            if name in names and row.vertical is not None
        }

    def priors(
        self, frame: MapFrame, names: Collection[str], assumed: AssumedSigmas
    ) -> dict[str, Prior]:
        """Return the priors of photographs, in the map's frame.

        An unknown height has an infinite standard deviation.

        Args:
            frame: frame of the map.
            names: photographs to return the priors of.
            assumed: standard deviations for rows that state none.

        Raises:
            InputError: for the reasons of ``MapFrame.position_of``, or a standard deviation is
                neither stated nor assumed.
        """
        rows = {name: row for name, row in self.rows.items() if name in names}
        self._warn(list(rows.values()), assumed)
        return {name: _prior(row, frame.position_of(row), assumed) for name, row in rows.items()}

    def _warn(self, rows: Collection[StatedPrior], assumed: AssumedSigmas) -> None:
        """Warn of unstated heights and standard deviations, one line each."""
        heights = sum(row.vertical is None for row in rows)
        positions = sum(row.sigma_m is None for row in rows)
        attitudes = sum(row.rotation is not None and row.sigma_deg is None for row in rows)
        doubts = [
            (heights, "heights", "they are taken near the height of the map's cameras"),
            (positions, "sigma_m", assumed.sigma_m_source),
            (attitudes, "sigma_deg", assumed.sigma_deg_source),
        ]
        for count, what, instead in doubts:
            if count and instead:
                values = (self.path, count, len(rows), what, instead)
                log.warning("%s: %d of %d rows state no %s: %s", *values)


def _prior(row: StatedPrior, position: NDArray[np.float64], assumed: AssumedSigmas) -> Prior:
    """Return the prior of a row."""
    sigma = assumed.sigma_m if row.sigma_m is None else np.full(3, row.sigma_m)
    if sigma is None:
        raise _sigma_error(row, "position", "sigma_m")
    if row.vertical is None:
        sigma = np.array([*sigma[:2], np.inf])
    if row.rotation is None:
        return Prior(position, sigma)
    degrees = assumed.sigma_deg if row.sigma_deg is None else row.sigma_deg
    if degrees is None:
        raise _sigma_error(row, "attitude", "sigma_deg")
    return Prior(position, sigma, row.rotation, degrees)


def _sigma_error(row: StatedPrior, what: str, column: str) -> InputError:
    """Return the error for a row without a standard deviation."""
    return InputError(f"{row.where}: the accuracy of the {what} is unknown: add a value {column}")
