"""The result of one query, as a results file holds it."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from objconnect.scene.bundle.manifest import Condition
from objconnect.scene.geometry.geodesy import FARTHEST_M
from objconnect.scene.localizer import By, Status
from objconnect.scene.storage.answers import Named, PoseNumbers

MOST: Final = 10**12
"""Larger numbers in a file are damage; sums of them could overflow."""

LARGEST_NEES: Final = 1e100
# 180 degrees, with room for the rounding errors of a quaternion.
_MOST_DEG: Final = 180.001
_Length = Annotated[float, Field(ge=-10 * FARTHEST_M, le=10 * FARTHEST_M)]
_Count = Annotated[int, Field(ge=0, le=MOST)]
_Time = Annotated[float, Field(ge=0, le=MOST)]

# The stage with the whole time of a query, measured outside the method.
TOTAL = "total"


class QueryResult(Named):
    """The result of one query.

    Attributes:
        name: name of the photograph.
        condition: condition that it was taken under.
        group: flight or drive that it belongs to.
        altitude_m: height of the reference position above the map's points, metres.
        status: status of the estimate.
        reason: why the status is not ``ok``.
        t_err_m: distance between the camera centres, metres; None without a pose.
        r_err_deg: angle between the rotations, degrees; None without a pose.
        cam_from_world: estimated pose as qw qx qy qz tx ty tz; None without a pose.
        sigma_t_m: predicted standard deviation of the camera centre, metres; None if unknown.
        nees: normalised estimation error squared, 6 degrees of freedom; None without covariance.
        iterations: number of iterations that the method reports.
        inliers: number of inliers that the method reports.
        seconds: wall-clock seconds by stage.
        by: what gave the pose; None if unknown.
        probability: probability that the method's best pose is right; None if unknown.
    """

    condition: Condition
    group: str
    altitude_m: _Length
    status: Status
    reason: str
    t_err_m: _Length | None = Field(ge=0)
    r_err_deg: float | None = Field(ge=0, le=_MOST_DEG)
    cam_from_world: PoseNumbers | None
    sigma_t_m: _Length | None
    nees: float | None = Field(ge=0, le=LARGEST_NEES)
    iterations: _Count
    inliers: _Count
    seconds: dict[str, _Time]
    by: By | None = None
    probability: float | None = Field(None, ge=0, le=1)
