"""Accuracy of a position on earth, from the accuracies of the pose in the map and of the map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.georeference import Georeference


@dataclass(frozen=True)
class EarthAccuracy:
    """The uncertainty of a position on earth; each part is None if unknown.

    Attributes:
        eph_m: horizontal standard deviation, metres: the square root of the sum of the variances to
            the east and to the north.
        epv_m: vertical standard deviation, metres.
        covariance: (3, 3) of the position to the east, north and up, m^2.
    """

    eph_m: float | None = None
    epv_m: float | None = None
    covariance: NDArray[np.float64] | None = None


def combine_accuracies(
    pose_covariance: NDArray[np.float64] | None, georeference: Georeference | None
) -> EarthAccuracy:
    """Return the accuracy of a position on earth.

    The error of a pose within the map and the error of the map on earth are independent, so their
    variances add up.

    Args:
        pose_covariance: covariance (6, 6) of a pose in the map, ``Estimate.world_covariance``; None
            if unknown.
        georeference: accuracy of the map's position on earth; None if unknown.
    """
    if pose_covariance is None or georeference is None:
        return EarthAccuracy()
    total = pose_covariance[:3, :3] + np.diag(
        [georeference.axis_m**2, georeference.axis_m**2, (georeference.vertical_m or 0.0) ** 2]
    )
    eph = math.sqrt(total[0, 0] + total[1, 1])
    if georeference.vertical_m is None:
        return EarthAccuracy(eph_m=eph)
    return EarthAccuracy(eph, math.sqrt(total[2, 2]), total)
