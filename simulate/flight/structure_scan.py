"""Structure scans of QGroundControl: flights around a polygon in layers, looking inwards.

QGroundControl saves a scan of version 3 without commands and generates them from its fields: the
aircraft flies around the polygon at ``DistanceToSurface``, at one height in each layer. The spacing
of layers is ``AdjustedFootprintFrontal``, that of photographs ``AdjustedFootprintSide``. The start
corner is not saved; the first corner is used, as in QGroundControl.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic, geodetic_from_enu
from simulate.flight.commands import Command, Mav

Array = NDArray[np.float64]

_VERSION: Final = 3
_ABOVE_HOME: Final = 3  # MAV_FRAME
# From a corner to the next, the structure is on the right.
_TO_THE_RIGHT_DEG: Final = 90.0
_MAX_LAYERS: Final = 1000
_ROUNDING: Final = 1e-6  # tolerance of a computed number of layers

_Length = Annotated[float, Field(gt=0, le=10_000)]


class StructureScan(BaseModel):
    """The fields of a scan.

    Attributes:
        version: Version of the format.
        polygon: Latitude and longitude of the corners, degrees.
        entrance_m: Height of entrance and exit above home, metres.
        bottom_m: Height of the bottom of the scan above home, metres.
        top_m: Height of the structure above home, metres.
        layers: Number of layers.
        pitch_deg: Pitch of the camera, degrees.
        from_top: Whether the first layer is the highest.
        distance_m: Distance of the flight from the polygon, metres.
        photograph_spacing_m: Distance between photographs, metres.
        layer_spacing_m: Distance between layers, metres.
    """

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, frozen=True)

    version: int
    polygon: tuple[tuple[float, float], ...]
    entrance_m: float = Field(alias="EntranceAltitude")
    bottom_m: float = Field(alias="ScanBottomAlt")
    top_m: float = Field(alias="StructureHeight")
    layers: float = Field(alias="Layers")
    pitch_deg: float = Field(alias="GimbalPitch")
    from_top: bool = Field(alias="StartFromTop")
    distance_m: _Length
    photograph_spacing_m: _Length
    layer_spacing_m: _Length

    def commands(self, where: str) -> Iterator[Command]:
        """Yield the commands of the scan, as QGroundControl generates them.

        Args:
            where: Position in the file, for messages.

        Raises:
            InputError: The fields do not define a flight.
        """
        self._check(where)
        corners = [(float(lat), float(lon)) for lat, lon in self._flight_corners(where)]
        step = -self.layer_spacing_m if self.from_top else self.layer_spacing_m
        height = (self.top_m if self.from_top else self.bottom_m) + step / 2
        look = (0.0, 0.0, 0.0, 0.0, self.pitch_deg, 0.0, _TO_THE_RIGHT_DEG)
        yield _waypoint(corners[0], self.entrance_m, where)
        yield Command(command=Mav.ROI_NEXT, params=look, where=where)
        for _ in range(int(self.layers)):
            yield _waypoint(corners[0], height, where)
            yield _trigger(self.photograph_spacing_m, where)
            for corner in (*corners[1:], corners[0]):
                yield _waypoint(corner, height, where)
            yield _trigger(0.0, where)
            height += step
        yield Command(command=Mav.ROI_NONE, params=(0.0,) * 7, where=where)
        yield _waypoint(corners[0], self.entrance_m, where)

    def _check(self, where: str) -> None:
        if self.version != _VERSION:
            raise InputError(
                f"{where} is a StructureScan of version {self.version}, which is not supported: "
                "save it again in QGroundControl"
            )
        if not 1 <= self.layers <= _MAX_LAYERS or self.layers != int(self.layers):
            raise InputError(
                f"{where} has {self.layers:g} Layers: set a whole number from 1 to {_MAX_LAYERS}"
            )
        exact_layers = max(self.top_m - self.bottom_m, 0.0) / self.layer_spacing_m
        if self.layers not in [max(math.ceil(exact_layers + off), 1) for off in (-_ROUNDING, 0.0)]:
            raise InputError(
                f"{where} has {self.layers:g} Layers, but StructureHeight, ScanBottomAlt and "
                f"AdjustedFootprintFrontal make {max(math.ceil(exact_layers), 1)}: save it again "
                "in QGroundControl"
            )
        if len(self.polygon) < 3:
            raise InputError(
                f"{where} has a polygon of {len(self.polygon)} corners: draw 3 or more"
            )
        if any(abs(lat) > 90 or abs(lon) > 180 for lat, lon in self.polygon):
            raise InputError(f"{where} has a polygon that is not on earth: correct it")

    def _flight_corners(self, where: str) -> Array:
        """Return latitude and longitude of the corners of the flight, (N, 2) degrees."""
        origin = Geodetic(*self.polygon[0], 0.0)
        geodetic = [Geodetic(lat, lon, 0.0) for lat, lon in self.polygon]
        corners = np.array([enu_from_geodetic(corner, origin)[:2] for corner in geodetic])
        after = np.roll(corners, -1, axis=0)
        ahead = after - corners
        length = np.linalg.norm(ahead, axis=1, keepdims=True)
        area = float((corners[:, 0] * after[:, 1] - corners[:, 1] * after[:, 0]).sum())
        if not length.all():
            raise InputError(f"{where} has a polygon with a corner twice: draw it again")
        if not area < 0:
            raise InputError(
                f"{where} has a polygon that is not clockwise, so that the camera would look away "
                "from it: draw it again"
            )
        ahead /= length
        outwards = np.column_stack([-ahead[:, 1], ahead[:, 0]])
        offset = [
            _intersect(
                corners[k] + self.distance_m * outwards[[k - 1, k]], ahead[[k - 1, k]], where
            )
            for k in range(len(corners))
        ]
        flown = [geodetic_from_enu(np.array([*xy, 0.0]), origin) for xy in offset]
        return np.array([[corner.latitude, corner.longitude] for corner in flown])


def _intersect(starts: Array, directions: Array, where: str) -> Array:
    """Intersect two lines through points (2, 2) along unit directions (2, 2)."""
    if abs(float(np.linalg.det(directions))) < 1e-6:
        raise InputError(f"{where} has a polygon with a corner on a straight side: remove it")
    along = np.linalg.solve(np.column_stack([directions[0], -directions[1]]), starts[1] - starts[0])
    return np.asarray(starts[0] + along[0] * directions[0])


def _waypoint(corner: tuple[float, float], height: float, where: str) -> Command:
    params = (0.0, 0.0, 0.0, None, *corner, height)
    return Command(command=Mav.WAYPOINT, frame=_ABOVE_HOME, params=params, where=where)


def _trigger(spacing_m: float, where: str) -> Command:
    at_once = 1.0 if spacing_m else 0.0
    params = (spacing_m, 0.0, at_once, 0.0, 0.0, 0.0, 0.0)
    return Command(command=Mav.TRIGGER_DISTANCE, params=params, where=where)
