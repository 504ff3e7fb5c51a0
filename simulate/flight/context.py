"""The inputs of flight planners besides the flight: rendered place, camera, wind, defaults."""

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

FreeTest = Callable[[Array], NDArray[np.bool_]]
"""Whether each of the positions (N, 3), world metres, is free for a camera, (N,)."""

MAX_PHOTOGRAPHS: Final = 20_000
"""Maximum number of photographs of a flight; more indicate a mistake."""


@dataclass(frozen=True)
class Wind:
    """Deviations of exposures from their planned poses by wind.

    Attributes:
        position_jitter_m: Standard deviation of each camera centre per axis, metres.
        attitude_jitter_deg: Standard deviation of yaw, pitch and roll, degrees.
    """

    position_jitter_m: float = 0.0
    attitude_jitter_deg: float = 0.0


_DEFAULT_ORIGIN: Final = Geodetic(0.0, 0.0, 0.0)


def _is_free_everywhere(centres: Array) -> NDArray[np.bool_]:
    return np.ones(len(centres), bool)


@dataclass(frozen=True)
class FlightContext:
    """The inputs of a flight planner besides the flight: place, camera, wind and defaults.

    Attributes:
        side_m: Side of the square place around the origin, metres.
        ground_height: Height of the ground in metres at world x, y in metres.
        camera: The camera of the photographs; its footprint is approximated by a pinhole.
        defaults: Values of options that the flight does not set; they depend on its session's role.
        wind: Deviations from planned poses.
        roads: The roads that corridors and streets may follow.
        is_free: Returns which positions (N, 3) in world metres are free for a camera.
        origin: Geodetic coordinates of the world's origin, for mission plans.
    """

    side_m: float
    ground_height: GroundHeight
    camera: Camera
    defaults: FlightPlan = MAP_PLAN
    wind: Wind = Wind()
    roads: tuple[Road, ...] = ()
    is_free: FreeTest = _is_free_everywhere
    origin: Geodetic = _DEFAULT_ORIGIN

    def footprint_m(self, altitude_m: float) -> tuple[float, float]:
        """Return the width and height of a nadir photograph's footprint on flat ground, metres."""
        focal = self.camera.focal[0]
        return self.camera.width * altitude_m / focal, self.camera.height * altitude_m / focal
