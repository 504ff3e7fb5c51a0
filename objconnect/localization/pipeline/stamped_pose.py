"""A pose with time, position on earth and covariance, for messages to autopilots and robots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from objconnect.localization.pipeline.accuracy import EarthAccuracy
from objconnect.scene.geometry.geodesy import Geodetic


@dataclass(frozen=True)
class StampedPose:
    """The pose of a localized camera with the time of its photograph.

    Attributes:
        microseconds: time since 1970, UTC.
        place: position of the camera on earth.
        centre: position of the camera in the map's frame, (3,) metres east, north and up.
        world_from_cam: rotation (3, 3) from the camera's axes (right, down, forward) to the map's.
        covariance: (6, 6) of centre (m) and attitude (rad) within the map, about east, north and
            up; None if unknown.
        accuracy: accuracy of ``place``, which includes the accuracy of the map on earth.
    """

    microseconds: int
    place: Geodetic
    centre: NDArray[np.float64]
    world_from_cam: NDArray[np.float64]
    covariance: NDArray[np.float64] | None
    accuracy: EarthAccuracy
