"""The place and camera that planners of flights take besides the flight's configuration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic
from simulate.flight.config import MAP_PLAN, FlightPlan
from simulate.place.world import Road

Array = NDArray[np.float64]
GroundHeight = Callable[[Array, Array], Array]
"""Ground height in metres at world x, y (N,) metres, such as ``World.terrain.height``."""

MAX_PHOTOGRAPHS: Final = 20_000
"""The most photographs of one flight; a flight that needs more is taken for a mistake."""


@dataclass(frozen=True)
class Wind:
    """The deviation of exposures from their planned poses.

    Attributes:
        position_jitter_m: Standard deviation of each camera centre per axis, metres.
        attitude_jitter_deg: Standard deviation of yaw, pitch and roll, degrees.
    """

    position_jitter_m: float = 0.0
    attitude_jitter_deg: float = 0.0


_ANYWHERE: Final = Geodetic(0.0, 0.0, 0.0)


def _is_free_everywhere(centres: Array) -> NDArray[np.bool_]:
    return np.ones(len(centres), bool)


@dataclass(frozen=True)
class FlightSite:
    """The place over which a flight is planned, and the camera that photographs it.

    Attributes:
        area_m: Side of the square place, which is centred on the origin, metres.
        ground_height: Height of the ground in metres at world x, y in metres.
        camera: The camera of the photographs. Its footprint is taken to be that of a pinhole.
        usual: The numbers of a flight whose configuration leaves them out.
        wind: How far exposures are from their planned poses.
        roads: The roads that corridors and streets may follow.
        is_free: Tells which of (N, 3) positions in world metres a camera can be at.
        origin: Where on earth the origin of the world lies; only mission plans need it.
    """

    area_m: float
    ground_height: GroundHeight
    camera: Camera
    usual: FlightPlan = MAP_PLAN
    wind: Wind = Wind()
    roads: tuple[Road, ...] = ()
    is_free: Callable[[Array], NDArray[np.bool_]] = _is_free_everywhere
    origin: Geodetic = _ANYWHERE

    def footprint_m(self, altitude_m: float) -> tuple[float, float]:
        """Return the width and height in metres of a photograph of flat ground straight below."""
        focal = self.camera.focal[0]
        return self.camera.width * altitude_m / focal, self.camera.height * altitude_m / focal
