"""The result of one query, as a results file holds it."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from objconnect.scene.bundle.manifest import Condition
from objconnect.scene.geometry.geodesy import FARTHEST_M
from objconnect.scene.localizer import PoseSource, Status
from objconnect.scene.storage.answers import NamedRecord, PoseNumbers

MAX_STORED: Final = 10**12
"""Files with larger numbers are refused as damaged; sums of such numbers could overflow."""

LARGEST_NEES: Final = 1e100
"""Larger values are stored as this one."""
# 180 degrees, with a margin for the rounding errors of a quaternion.
_MAX_DEG: Final = 180.001
_Length = Annotated[float, Field(ge=-10 * FARTHEST_M, le=10 * FARTHEST_M)]
_Count = Annotated[int, Field(ge=0, le=MAX_STORED)]
_Time = Annotated[float, Field(ge=0, le=MAX_STORED)]

# The stage with the whole time of a query, measured outside the method.
TOTAL = "total"


class QueryResult(NamedRecord):
    """The result of one query.

    Attributes:
        name: name of the photograph.
        condition: condition that it was taken under.
        group: flight or drive that it belongs to.
        course: path of that flight; flights along the same path are not independent. None in files
            of earlier versions, where every group counts as a course of its own.
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
        by: what the pose was computed from, such as matches; None if unknown.
        probability: probability that the method's best pose is right; None if unknown.
        prior_t_m: position error of the query's prior, metres; None without a prior position, and
            in files of earlier versions with the start "prior".
    """

    condition: Condition
    group: str
    course: str | None = None
    altitude_m: _Length
    status: Status
    reason: str
    t_err_m: _Length | None = Field(ge=0)
    r_err_deg: float | None = Field(ge=0, le=_MAX_DEG)
    cam_from_world: PoseNumbers | None
    sigma_t_m: _Length | None
    nees: float | None = Field(ge=0, le=LARGEST_NEES)
    iterations: _Count
    inliers: _Count
    seconds: dict[str, _Time]
    by: PoseSource | None = None
    probability: float | None = Field(None, ge=0, le=1)
    prior_t_m: _Length | None = Field(None, ge=0)

    @property
    def course_name(self) -> str:
        """Return the course, or the group in files of earlier versions.

        Intervals and tests take the queries of one course as one independent unit.
        """
        return self.group if self.course is None else self.course
