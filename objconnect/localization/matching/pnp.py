"""A pose from matches to 3D points, or why there is none."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from objconnect.scene.config import Config
from objconnect.scene.localizer import By, Estimate, Query, Status, Stopwatch

MIN_MATCHES: Final = 4
"""Matches that PnP needs."""
# Of RANSAC.
_SEED: Final = 0


class PnpConfig(Config):
    """Options of localizers that solve for the pose by PnP."""

    max_error_px: float = Field(4.0, gt=0, description="Inlier threshold of PnP.")
    min_inliers: int = Field(12, ge=4, description="Fewer inliers count as a failure.")
    use_gnss: bool = Field(
        True, description="Let a position prior of known sigma take part in the refinement."
    )
    error_reach: float = Field(
        0.09,
        ge=0,
        le=1,
        description="Distance, as a share of the picture's longest side, within which errors of "
        "matches are alike, as far as their residuals are; covariances grow by it. 0 takes matches "
        "for independent.",
    )


def solve_pose(
    query: Query,
    xy: NDArray[np.float64],
    xyz: NDArray[np.float64],
    config: PnpConfig,
    clock: Stopwatch,
) -> Estimate:
    """Solve for the pose of a query; ``FAILED`` with a reason where too few matches agree.

    Args:
        query: the query; its camera and prior are used.
        xy: (N, 2) COLMAP pixels of the query.
        xyz: (N, 3) the points that they show, world metres.
        config: when matches agree, and how many must.
        clock: receives the time as stage ``pose``; its stages are those of the answer.
    """
    if len(xyz) < MIN_MATCHES:
        reason = f"{len(xyz)} matches to the map, {MIN_MATCHES} are needed"
        return Estimate(Status.FAILED, seconds=clock.seconds, reason=reason)
    with clock.stage("pose"):
        # pycolmap takes 60 MB, which methods without PnP are spared.
        from objconnect.scene.colmap.absolute_pose import estimate_absolute_pose

        prior = query.prior if config.use_gnss else None
        result = estimate_absolute_pose(
            xy,
            xyz,
            query.camera,
            config.max_error_px,
            prior,
            _SEED,
            config.error_reach,
        )
    inliers = int(result.inliers.sum()) if result else 0
    if result is None or inliers < config.min_inliers:
        reason = f"{inliers} of {len(xyz)} matches agree, {config.min_inliers} are needed"
        return Estimate(Status.FAILED, inliers=inliers, seconds=clock.seconds, reason=reason)
    return Estimate(
        Status.OK,
        result.cam_from_world,
        result.covariance,
        inliers=inliers,
        seconds=clock.seconds,
        by=By.MATCHES,
    )
