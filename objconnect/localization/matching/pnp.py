"""Pose estimation from matches to 3D points by PnP and RANSAC."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from objconnect.scene.config import Config
from objconnect.scene.localizer import Estimate, PoseSource, Query, Status, Stopwatch

MIN_MATCHES: Final = 4
"""Number of matches that PnP needs."""
# Seed of RANSAC.
_SEED: Final = 0


class PnpConfig(Config):
    """Options of localizers that solve for the pose by PnP."""

    max_error_px: float = Field(4.0, gt=0, description="Inlier threshold of RANSAC, px.")
    min_inliers: int = Field(
        12, ge=4, description="Minimum number of inliers; with fewer the pose fails."
    )
    use_gnss: bool = Field(
        True, description="Use the prior's position, if its sigma is known, to refine the pose."
    )
    error_reach: float = Field(
        0.09,
        ge=0,
        le=1,
        description="Matches closer to each other than this share of the longer image side are "
        "treated as having correlated errors. The correlation is estimated from the residuals, and "
        "it enlarges the pose covariance. 0 treats matches as independent.",
    )


def solve_pose(
    query: Query,
    xy: NDArray[np.float64],
    xyz: NDArray[np.float64],
    config: PnpConfig,
    clock: Stopwatch,
) -> Estimate:
    """Estimate the pose of a query; ``FAILED`` with a reason if too few matches agree.

    Args:
        query: the query; its camera and prior are used.
        xy: (N, 2) COLMAP pixels of the query.
        xyz: (N, 3) matched points, world metres.
        config: options of PnP.
        clock: takes the time as stage ``pose``.
    """
    if len(xyz) < MIN_MATCHES:
        reason = f"{len(xyz)} matches to the map, {MIN_MATCHES} are needed"
        return Estimate(Status.FAILED, seconds=clock.seconds, reason=reason)
    with clock.stage("pose"):
        # Imported here because pycolmap takes 60 MB.
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
        by=PoseSource.MATCHES,
    )
